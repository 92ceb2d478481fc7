"""Reader and writer for FITS cubes."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError
from ...units import unit_name
from ..contract import FieldChoice, FieldInfo, Reader
from ..names import chosen_fields
from ..payload import is_packed, unpacked
from .cubes import Cube, cubes, images
from .hdus import HDU, card, parts, values
from .layout import CubeLayout, ThirdAxis, layout, unit_cells
from .wcs import World, has_world, world
from .write import DEPTH, UNIT, write

if TYPE_CHECKING:
    from ...volume import Volume

_MAGIC = b"SIMPLE  ="
# Mark that `Image.save` writes into the first header; volumes lack it.
_CREATOR, _TEXT = "CREATOR", "VOLMETA"
# Cards about the observation, stored in `Volume.meta` under their lower-case names.
_META_CARDS = (
    *("OBJECT", "TELESCOP", "INSTRUME", "OBSERVER", "DATE-OBS", "BUNIT", "BMAJ", "BMIN", "BPA"),
    *("SPECSYS", "RADESYS", "EQUINOX", "RESTFRQ", "RESTFREQ", "RESTWAV", "LINE"),
)


class FITSReader(Reader):
    """Cubes in FITS files: position-position-velocity, or in space."""

    name = "fits"
    description = "a FITS file"
    suffixes = (".fits", ".fit", ".fts")
    writes = True
    options = {  # noqa: RUF012 - as in Reader
        "hdu": "number or name (EXTNAME) of the HDU; by default all cubes that lie on one grid",
        "plane": "which pixel (from 0) along a fourth axis; one for each further axis",
        "unit": "unit of the grid: of the sky (arcsec or deg by default), or of length",
        "depth": "depth of a spectral axis in the grid's unit; by default the width of the sky",
        "spectral_scale": "in place of depth: the grid's unit per km/s (or GHz, um …)",
        "velocity": "Doppler convention: 'radio', 'optical' or 'relativistic'",
        "rest": "frequency or wavelength at rest, such as '110.2 GHz'",
        "bounds": "((x0, x1), (y0, y1), (z0, z1)) in place of the header's coordinates",
        "wcs": "False ignores the header's coordinates: cells of unit length",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        if not is_packed(head):
            return head.startswith(_MAGIC)
        try:
            with unpacked(path) as file:
                return file.read(len(_MAGIC)) == _MAGIC
        except Exception:  # damaged, or of another kind
            return False

    def holds_image(self, path: Path) -> bool:
        try:
            hdus = parts(path)
        except Exception:  # damaged: reading it raises the error
            return False
        return _is_picture(hdus) or not any(len(real) >= 3 for _, real in images(hdus))

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        every = _cubes(path, options)
        infos = [cube.info() for cube in every]
        axis = _layout(every[0], options)[1].axis
        if axis is not None and axis.name not in {field.name for field in infos}:
            shape = tuple(every[0].sides[::-1])
            infos.append(FieldInfo(axis.name, axis.name, shape, "float32", unit_name(axis.unit)))
        return tuple(infos)

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        from ...volume import Volume

        every = _cubes(path, options)
        by_place = {cube.place: cube for cube in every}
        names = {cube.place: cube.name for cube in every}
        axis = _layout(every[0], options)[1].axis
        if axis is not None and axis.name not in names.values():
            names[axis.name] = axis.name
        chosen = chosen_fields(names, fields)
        own = [by_place[place] for place in chosen.values() if place in by_place] or every[:1]
        sky, where = _common(own, options)
        volume = Volume(where.grid)
        volume.wcs = where.wcs
        volume.meta.update(_meta_of(own[0].part, sky, where))
        for name, place in chosen.items():
            if place in by_place:
                cube = by_place[place]
                load = functools.partial(_load, path, cube, sky)
                volume[name] = Deferred(load, cube.scaling.dtype, cube.unit)
            else:
                assert where.axis is not None
                spread = functools.partial(_spread, where.axis, where.grid.shape)
                volume[name] = Deferred(spread, np.float32, where.axis.unit)
        return volume

    def write(self, volume: Volume, path: Path) -> None:
        write(volume, path)


def _is_picture(hdus: list[HDU]) -> bool:
    header = hdus[0].header
    return card(header, _CREATOR) == "voluminous" and _TEXT in header


def _cubes(path: Path, options: dict[str, Any]) -> list[Cube]:
    hdus = parts(path)
    if _is_picture(hdus):
        raise FileFormatError("expected a volume; this is an image: vm.Image.load reads it")
    return cubes(hdus, options.get("hdu"), options.get("plane"))


def _layout(cube: Cube, options: dict[str, Any]) -> tuple[World | None, CubeLayout]:
    """Return the world coordinates of a cube (None if missing or not wanted) and its layout."""
    bounds, unit = options.get("bounds"), options.get("unit")
    header = cube.part.header
    if bounds is not None or options.get("wcs") is False or not has_world(cube.part):
        return None, unit_cells(cube.sides, bounds, unit)
    place = world(cube.part, cube.axes, cube.sides, options.get("velocity"), options.get("rest"))
    depth, scale = options.get("depth"), options.get("spectral_scale")
    if unit is None and card(header, UNIT):  # we wrote it
        unit = card(header, UNIT)
        depth = card(header, DEPTH) if depth is None and scale is None else depth
    return place, layout(place, header, unit, depth, scale)


def _common(chosen: list[Cube], options: dict[str, Any]) -> tuple[World | None, CubeLayout]:
    """Return the world coordinates and layout that all cubes share."""
    first = chosen[0]
    sky, where = _layout(first, options)
    for cube in chosen[1:]:
        same = cube.sides == first.sides and cube.axes == first.axes
        if same and sky is not None and has_world(cube.part):
            other = _layout(cube, options)[0]
            same = other is not None and sky.agrees(other)
        if not same:
            listed = ", ".join(f"{c.name} ({c.part.name}) {c.sides}" for c in chosen)
            raise InputError(
                f"cubes must lie on one grid to be read together, got {listed}; choose with hdu=… "
                "or fields=[…]"
            )
    return sky, where


def _load(path: Path, cube: Cube, sky: World | None) -> np.ndarray:
    arrange = (lambda stored: stored.T) if sky is None else sky.arrange
    return values(path, cube.part, cube.index, arrange)


def _spread(axis: ThirdAxis, shape: tuple[int, ...]) -> np.ndarray:
    return np.broadcast_to(axis.values.astype(np.float32), shape)


def _meta_of(part: HDU, sky: World | None, where: CubeLayout) -> dict[str, Any]:
    meta = {key.lower(): card(part.header, key) for key in _META_CARDS}
    meta = {k: v for k, v in meta.items() if v != "" and isinstance(v, (str, int, float))}
    if sky is not None and sky.on_sky:
        meta |= sky.pointing()
    return meta
