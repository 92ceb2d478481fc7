"""Reader for openPMD meshes (HDF5), 1.0 to 2.0: https://github.com/openPMD/openPMD-standard."""

from __future__ import annotations

import functools
import warnings
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..deferred import Deferred
from ..errors import FileFormatError, InputError, UnknownNameError, VoluminousError, unknown_name
from ..memory import check_memory
from ..units import parse_unit, unit_name
from .axes import round_unit
from .contract import FieldInfo, Reader
from .hdf5 import data_set, holds, is_own, opened, read, text
from .names import chosen_fields, field_name

if TYPE_CHECKING:
    from ..volume import Volume

_AXES = {"cartesian": "xyz", "thetaMode": "rz"}
# Our names of vector components in cylindrical coordinates.
_AROUND = {"r": "R", "t": "phi"}
_SI = ("m", "kg", "s", "A", "K", "mol", "cd")
_NAMED = ("V / m", "T", "C / m3", "A / m2", "C", "V", "A", "N", "J", "J / m3", "W / m2")
_LENGTH = [1.0, *[0.0] * 6]


class MeshPoints(NamedTuple):
    """Positions of mesh values; `low` is half a spacing before the first one, in metres."""

    geometry: str
    axes: str
    shape: tuple[int, ...]
    low: tuple[float, ...]
    spacing: tuple[float, ...]
    is_length: bool


class MeshPart(NamedTuple):
    """A component of a mesh; `factor` converts to its unit, `sign` is that of imaginary parts."""

    name: str
    place: str
    item: str
    dtype: Any
    unit: Any
    factor: float
    sign: int
    points: MeshPoints


class OpenPMDReader(Reader):
    """Cartesian meshes with three axes, and azimuthal-mode meshes (thetaMode)."""

    name = "openpmd"
    description = "an openPMD file with meshes (HDF5)"
    options = {  # noqa: RUF012 - as in Reader
        "iteration": "number of the iteration; by default the last in the file",
        "unit": "unit of length of the grid; by default one in which it has a handy size",
        "centred": "True: treat staggered values as if they were at the centres of their cells, "
        "which is up to half a cell off, so that they share one grid",
        "azimuths": "cells around the axis of thetaMode meshes; by default 32 per mode",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return holds(path, head, lambda file: {"openPMD", "basePath"} <= set(file.attrs))

    def read(
        self, path: Path, fields: Any = None, *, unit: Any = None, azimuths: Any = None, **at: Any
    ) -> Volume:
        from ..volume import Volume

        meshes, meta = _meshes(path, **at)
        chosen = _on_one_grid(meshes, fields, meta.get("left_out", {}))
        points = next(iter(chosen.values())).points
        grid, angles = _grid(points, unit, azimuths)
        volume = Volume(grid)
        volume.meta.update(meta)
        for name, mesh in chosen.items():
            exact = mesh.factor == 1 and points.geometry == "cartesian"
            dtype = np.dtype(mesh.dtype).newbyteorder("=") if exact else np.float64
            load = functools.partial(_load, path, mesh, angles)
            volume[name] = Deferred(load, dtype, mesh.unit)
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        meshes, _ = _meshes(path, options.get("iteration"), options.get("centred", False))
        return tuple(
            FieldInfo(m.name, m.place, m.points.shape, str(m.dtype), unit_name(m.unit))
            for m in meshes
        )


def _meshes(
    path: Path, iteration: Any = None, centred: bool = False
) -> tuple[list[MeshPart], dict[str, Any]]:
    if not isinstance(centred, bool):
        raise InputError(f"centred must be True or False, got {centred!r}")
    found: list[MeshPart] = []
    with opened(path) as file:
        base, meta = _iteration(file, iteration)
        place = text(file.attrs.get("meshesPath")).strip("/")
        group = base[place] if place and place in base else {}
        own = [name for name in group if is_own(group, name)]
        left = {name: "a link" for name in group if name not in own}
        for name in own:
            record = group[name]
            whole = hasattr(record, "shape") or "value" in record.attrs
            for part, item in (("", record),) if whole else record.items():
                try:
                    found.append(_mesh(path, group, name, part, record, item, centred))
                except VoluminousError as error:
                    left[f"{name}/{part}".rstrip("/")] = str(error)
    if not found:
        raise InputError(
            f"expected meshes that can be fields{_left_out(left) or '; there are none'}. Particles "
            "can be read with h5py, and put on a grid with vm.Volume.from_particles"
        )
    return found, meta | ({"left_out": left} if left else {})


def _left_out(left: dict[str, str]) -> str:
    return "".join(f"; left out is {place}: {why}" for place, why in left.items())


def _iteration(file: Any, wanted: Any) -> tuple[Any, dict[str, Any]]:
    before, _, after = text(file.attrs["basePath"]).partition("%T")
    root = file[before.strip("/") or "/"]
    groups = {int(name): f"{name}/{after}".strip("/") for name in root if name.isdigit()}
    if not groups:  # variable-based series: the group itself is the iteration
        groups = {int(np.ravel(root.attrs.get("snapshot", 0))[0]): "."}
    number = max(groups) if wanted is None else wanted
    if not isinstance(number, int):
        raise InputError(f"iteration must be a whole number, got {wanted!r}")
    if number not in groups:
        raise unknown_name("iteration", str(wanted), [str(n) for n in sorted(groups)])
    base = root[groups[number]]
    meta: dict[str, Any] = {"iteration": number}
    if len(groups) > 1:
        meta["iterations"] = sorted(groups)
    if "time" in base.attrs:
        meta["time"] = float(_numbers(base, "time", 1)[0])
        if "timeUnitSI" in base.attrs:
            meta["time"] *= float(_numbers(base, "timeUnitSI", 1)[0])
            meta["time_unit"] = "s"
    return base, meta


def _mesh(
    path: Path, group: Any, name: str, part: str, record: Any, item: Any, centred: bool
) -> MeshPart:
    """Return a component; raise an error that explains why it cannot be a field."""
    place = f"{name}/{part}".rstrip("/")
    geometry = text(record.attrs.get("geometry", "cartesian"))
    if geometry not in _AXES:
        raise InputError(f"geometry {geometry!r}, expected cartesian or thetaMode")
    constant, fortran = "value" in item.attrs, text(record.attrs.get("dataOrder")) == "F"
    dtype = np.asarray(item.attrs["value"]).dtype if constant else item.dtype
    if dtype.kind not in "fiub":
        raise InputError(f"values of type {dtype}, expected real numbers")
    labels = [text(label).lower() for label in np.ravel(record.attrs.get("axisLabels", ()))]
    if sorted(labels) != sorted(_AXES[geometry]):
        raise InputError(f"axes {labels}, expected {list(_AXES[geometry])} in any order")
    counts = (
        np.ravel(item.attrs.get("shape", ())) if constant else data_set(path, group, place).shape
    )
    shape = tuple(int(n) for n in counts)
    # Lists follow the writer's index order, which for Fortran is the reverse of HDF5's. Some
    # writers give the shape of constants in HDF5's order: compare with the other components.
    if constant and fortran and shape not in {getattr(o, "shape", 0) for o in record.values()}:
        shape = shape[::-1]
    if len(shape) != 3 or min(shape) < 1 or (geometry == "thetaMode" and shape[0] % 2 == 0):
        raise FileFormatError(f"shape {shape}, expected that of a {geometry} mesh")
    along = np.argsort(labels)
    holder = item if "position" in item.attrs else record
    position = 0.5 if centred else _numbers(holder, "position", len(labels))[along]
    spacing = _numbers(record, "gridSpacing", len(labels))[along]
    low = _numbers(record, "gridGlobalOffset", len(labels))[along] + (position - 0.5) * spacing
    is_length = "gridUnitSI" in record.attrs
    scale = _numbers(record, "gridUnitSI", len(labels))[along] if is_length else 1.0
    dimension = np.ravel(record.attrs.get("gridUnitDimension", _LENGTH * len(labels)))
    if not (spacing * scale > 0).all() or not np.array_equal(dimension, _LENGTH * len(labels)):
        raise InputError(f"spacings {spacing.tolist()}, expected lengths above zero")
    axes = "".join(labels[::-1] if fortran else labels)
    is_si = "unitSI" in item.attrs
    mode_sign = -1 if "imag=-" in text(record.attrs.get("geometryParameters")) else 1
    ending = _AROUND.get(part, part) if geometry == "thetaMode" else part
    return MeshPart(
        field_name(f"{name}_{ending}" if part else name),
        place,
        item.name,
        dtype,
        _unit(record.attrs.get("unitDimension", ())) if is_si else None,
        float(_numbers(item, "unitSI", 1)[0]) if is_si else 1.0,
        mode_sign,
        MeshPoints(geometry, axes, shape, tuple(low * scale), tuple(spacing * scale), is_length),
    )


def _numbers(item: Any, name: str, count: int) -> np.ndarray:
    values = np.ravel(item.attrs.get(name, ()))
    if name == "position" and len(values) == 3:
        values = values[-count:]  # some writers add one for the modes
    sound = values.dtype.kind in "fiu" and len(values) in (1, count) and np.isfinite(values).all()
    if not sound or (len(values) < count and name != "gridUnitSI"):
        raise FileFormatError(f"{name} {values.tolist()}, expected {count} numbers")
    return np.broadcast_to(values.astype(np.float64), count)


def _unit(powers: Any) -> Any:
    """Return the SI unit with these powers of the base units, by its usual name if it has one."""
    from astropy import units as u

    base = u.dimensionless_unscaled
    for name, power in zip(_SI, np.ravel(powers).tolist(), strict=False):
        base = base * u.Unit(name) ** power if power else base
    named = (u.Unit(name) for name in _NAMED)
    return next((unit for unit in named if unit.decompose() == base), base)


def _on_one_grid(meshes: list[MeshPart], fields: Any, left: dict[str, str]) -> dict[str, MeshPart]:
    """Return {name: component} of the requested ones, or of the largest set on the same points."""
    by_place = {mesh.place: mesh for mesh in meshes}
    points = Counter(mesh.points for mesh in meshes).most_common(1)[0][0]
    known = {p: m.name for p, m in by_place.items() if fields is not None or m.points == points}
    try:
        chosen = {name: by_place[place] for name, place in chosen_fields(known, fields).items()}
    except UnknownNameError as error:
        raise UnknownNameError(f"{error.args[0]}{_left_out(left)}") from error
    groups: dict[MeshPoints, list[str]] = {}
    for mesh in meshes if fields is None else chosen.values():
        groups.setdefault(mesh.points, []).append(mesh.name)
    if len(groups) == 1:
        return chosen
    listed = " | ".join(", ".join(names) for names in groups.values())
    advice = (
        f"fields are at different points: {listed}. Open those of one group by name, or say "
        "centred=True to treat staggered values as if they were at the centres of their cells"
    )
    if fields is not None:
        raise InputError(advice)
    warnings.warn(f"read {', '.join(chosen)} only: {advice}", stacklevel=2)
    return chosen


def _grid(points: MeshPoints, unit: Any, azimuths: Any) -> tuple[Any, np.ndarray]:
    """Return the grid with one point per cell, and the azimuths of its cells."""
    from astropy import units as u

    from ..grids import CartesianGrid, CylindricalGrid

    axes = _AXES[points.geometry]
    counts = [points.shape[points.axes.index(a) - len(axes)] for a in axes]
    low, width = np.array(points.low), np.array(points.spacing)
    if points.is_length:
        unit = round_unit(max(counts * width) * u.m) if unit is None else parse_unit(unit)
        low, width = low * u.m.to(unit), width * u.m.to(unit)
    if points.geometry == "cartesian":
        ends = np.array([low, low + counts * width]).T
        return CartesianGrid.uniform(counts, ends, unit=unit), np.zeros(0)
    modes = points.shape[0] // 2
    around = max(32 * modes, 1) if azimuths is None else azimuths
    if not isinstance(around, int) or around < 2 * modes + 1:
        raise InputError(f"azimuths must be a whole number above {2 * modes}, got {azimuths!r}")
    R, z = (a + w * np.arange(n + 1) for a, w, n in zip(low, width, counts, strict=True))
    if R[0] < -0.51 * width[0]:
        raise InputError(f"radii begin at {R[0] + width[0] / 2:.6g}, expected zero or more")
    phi = np.linspace(0, 2 * np.pi, around + 1)
    return CylindricalGrid(np.maximum(R, 0), phi, z, unit=unit), (phi[1:] + phi[:-1]) / 2


def _load(path: Path, mesh: MeshPart, angles: np.ndarray) -> np.ndarray:
    points = mesh.points
    count = int(np.prod(points.shape[1:])) * max(points.shape[0], len(angles))
    check_memory(8 * count, f"reading {mesh.place}", "take fewer azimuths, or a coarser mesh")
    with opened(path) as file:
        item = file[mesh.item]
        constant = np.ravel(item.attrs.get("value", ()))
        values = np.full(points.shape, constant[0]) if len(constant) else read(item)
    values = values if mesh.factor == 1 else values * mesh.factor
    if points.geometry == "cartesian":
        return values.transpose([points.axes.index(a) for a in "xyz"])
    values = values.transpose(0, *(1 + points.axes.index(a) for a in "rz")).astype(np.float64)
    # F = Re₀ + Σ Reₘ cos(m θ) ± Imₘ sin(m θ), stored as Re₀, Re₁, Im₁, Re₂ …
    waves = [np.ones_like(angles)]
    for m in range(1, points.shape[0] // 2 + 1):
        waves += [np.cos(m * angles), mesh.sign * np.sin(m * angles)]
    return np.einsum("mrz,mp->rpz", values, np.array(waves), optimize=True)
