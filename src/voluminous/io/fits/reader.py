"""Reader and writer for FITS cubes."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError
from ...image.fits_header import as_fits, card, is_casa_image
from ...units import unit_name
from ..contract import FieldChoice, FieldInfo, Reader
from ..names import chosen_fields
from .cubes import Cube, FITSImage, cubes, images
from .layout import CubePlace, ThirdAxis, place_of
from .write import write

if TYPE_CHECKING:
    from ...volume import Volume

_MAGIC = b"SIMPLE  ="
# Mark that `Image.save` writes into the first header; volumes lack it. Cubes have an extension.
_CREATOR, _TEXT, _SPECTRAL = "CREATOR", "VOLMETA", "SPECTRAL"
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
        return head.startswith(_MAGIC)

    def holds_image(self, path: Path) -> bool:
        try:
            candidates = images(path)
        except Exception:  # damaged: reading it raises the error
            return False
        return _is_picture(candidates) or not any(len(image.real_axes) >= 3 for image in candidates)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        every, third = _cubes(path, options)
        infos = [
            FieldInfo(c.name, c.place, c.image.shape[::-1], str(c.dtype), unit_name(c.unit))
            for c in every
        ]
        if third is not None:
            shape, unit = every[0].sides[::-1], unit_name(third.unit)
            infos.append(FieldInfo(third.name, third.name, shape, "float32", unit))
        return tuple(infos)

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        from ...volume import Volume

        every, third = _cubes(path, options)
        by_place = {cube.place: cube for cube in every}
        names = {cube.place: cube.name for cube in every}
        if third is not None:
            names[third.name] = third.name
        chosen = chosen_fields(names, fields)
        wanted = [by_place[place] for place in chosen.values() if place in by_place] or every[:1]
        place = _common(wanted, options)
        volume = Volume(place.grid)
        volume.wcs = place.wcs
        meta = {key.lower(): card(wanted[0].image.header, key) for key in _META_CARDS}
        meta = {k: v for k, v in meta.items() if v != "" and isinstance(v, (str, int, float))}
        volume.meta |= meta | place.pointing()
        for name, where in chosen.items():
            if where in by_place:
                cube = by_place[where]
                load = functools.partial(cube.values, place.arrange)
                volume[name] = Deferred(load, cube.dtype, cube.unit)
            elif place.third is not None:
                spread = functools.partial(_spread, place.third, place.grid.shape)
                volume[name] = Deferred(spread, np.float32, place.third.unit)
        return volume

    def write(self, volume: Volume, path: Path) -> None:
        write(volume, path)


def _is_picture(candidates: list[FITSImage]) -> bool:
    """Return whether `Image.save` wrote the file, and it is no cube with a spectrum."""
    if not _is_ours(candidates):
        return False
    has_spectrum = any(image.title.upper() == _SPECTRAL for image in candidates)
    return not (has_spectrum and len(candidates[0].real_axes) >= 3)


def _is_ours(candidates: list[FITSImage]) -> bool:
    header = candidates[0].header if candidates and candidates[0].number == 0 else {}
    return card(header, _CREATOR) == "voluminous" and _TEXT in header


def _cubes(path: Path, options: dict[str, Any]) -> tuple[list[Cube], ThirdAxis | None]:
    candidates = images(path)
    if _is_picture(candidates):
        raise FileFormatError("expected a volume; this is an image: vm.Image.load reads it")
    if _is_ours(candidates) and options.get("hdu") is None:
        candidates = candidates[:1]  # the others are errors, optical depths …
    every = cubes(candidates, options.get("hdu"), options.get("plane"))
    third = place_of(every[0], options).third
    known = third is not None and third.name in {cube.name for cube in every}
    return every, None if known else third


def _common(chosen: list[Cube], options: dict[str, Any]) -> CubePlace:
    first, *others = (place_of(cube, options) for cube in chosen)
    if not all(first.agrees(other) for other in others) or len({c.axes for c in chosen}) > 1:
        listed = ", ".join(f"{c.name} ({c.image}) {c.sides}" for c in chosen)
        raise InputError(
            f"cubes must lie on one grid to be read together, got {listed}; choose with hdu=… "
            "or fields=[…]"
        )
    return first


def _spread(third: ThirdAxis, shape: tuple[int, ...]) -> np.ndarray:
    return np.broadcast_to(third.values.astype(np.float32), shape)


class CASAReader(Reader):
    """Images of CASA and casacore: ``.image``, ``.residual``, ``.psf`` …"""

    name = "casa"
    description = "a CASA image"
    suffixes = ()
    packages = ("casacore",)
    extra = "casa"
    options = FITSReader.options

    def matches(self, path: Path, head: bytes) -> bool:
        return is_casa_image(path)

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        with as_fits(path) as file:
            return FITSReader().read(file, fields, **options).load()  # the file is temporary

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        with as_fits(path) as file:
            return FITSReader().info(file, **options)
