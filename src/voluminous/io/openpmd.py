"""Reader for openPMD meshes (HDF5), 1.0 to 2.0: https://github.com/openPMD/openPMD-standard."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import FileFormatError, InputError, UnknownNameError, VoluminousError, unknown_name
from ..memory import check_memory
from ..units import UnitLike, parse_unit
from .axes import round_unit
from .contract import Contents, ContentsReader, FieldChoice, StoredField
from .hdf5 import data_set, holds, is_own, opened, read, text
from .names import chosen_fields, field_name

if TYPE_CHECKING:
    import h5py

    from ..grids import CartesianGrid, CylindricalGrid

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

    def azimuths(self, given: Any) -> np.ndarray:
        """Return the walls of the cells around the axis."""
        modes = self.shape[0] // 2
        around = max(32 * modes, 1) if given is None else given
        if not isinstance(around, int) or around < 2 * modes + 1:
            raise InputError(f"azimuths must be a whole number above {2 * modes}, got {given!r}")
        return np.linspace(0, 2 * np.pi, around + 1)


@dataclass(frozen=True)
class Meshes(Contents):
    """The meshes of one iteration; `left_out` has the reasons why others cannot be fields."""

    points: dict[str, MeshPoints] = field(default_factory=dict)  # by place
    left_out: dict[str, str] = field(default_factory=dict)


class OpenPMDReader(ContentsReader):
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

    def contents(self, path: Path, **options: Any) -> Meshes:
        centred, azimuths = options.get("centred", False), options.get("azimuths")
        if not isinstance(centred, bool):
            raise InputError(f"centred must be True or False, got {centred!r}")
        points: dict[str, MeshPoints] = {}
        fields: list[StoredField] = []
        with opened(path) as file:
            base, meta = _iteration(file, options.get("iteration"))
            place = text(file.attrs.get("meshesPath")).strip("/")
            group = base[place] if place and place in base else {}
            left = {name: "a link" for name in group if not is_own(group, name)}
            for name in group:
                if name in left:
                    continue
                record = group[name]
                whole = hasattr(record, "shape") or "value" in record.attrs
                for part, item in (("", record),) if whole else record.items():
                    place = f"{name}/{part}".rstrip("/")
                    try:
                        points[place] = _points(path, group, place, record, item, centred)
                        fields.append(
                            _field(path, name, part, record, item, points[place], azimuths)
                        )
                    except VoluminousError as error:
                        left[place] = str(error)
        if not fields:
            raise InputError(
                f"expected meshes that can be fields{_listed(left) or '; there are none'}. "
                "Particles can be read with h5py, and put on a grid with vm.Volume.from_particles"
            )

        def grid(chosen: Any) -> CartesianGrid | CylindricalGrid:
            return _grid(points[chosen[0].place], options.get("unit"), azimuths)

        return Meshes(fields, grid, meta | ({"left_out": left} if left else {}), points, left)

    def chosen(self, contents: Contents, fields: FieldChoice) -> Mapping[str, StoredField]:
        """Return the requested meshes, or the largest set on the same points."""
        assert isinstance(contents, Meshes)
        by_place, points = {f.place: f for f in contents.fields}, contents.points
        usual = Counter(points[place] for place in by_place).most_common(1)[0][0]
        names = {p: f.name for p, f in by_place.items() if fields is not None or points[p] == usual}
        try:
            chosen = {name: by_place[p] for name, p in chosen_fields(names, fields).items()}
        except UnknownNameError as error:
            raise UnknownNameError(f"{error.args[0]}{_listed(contents.left_out)}") from error
        groups: dict[MeshPoints, list[str]] = {}
        for f in by_place.values() if fields is None else chosen.values():
            groups.setdefault(points[f.place], []).append(f.name)
        if len(groups) > 1:
            listed = " | ".join(", ".join(names) for names in groups.values())
            advice = (
                f"fields are at different points: {listed}. Open those of one group by name, or "
                "say centred=True to treat staggered values as if they were at the centres of "
                "their cells"
            )
            if fields is not None:
                raise InputError(advice)
            warnings.warn(f"read {', '.join(chosen)} only: {advice}", stacklevel=2)
        return chosen


def _listed(left: dict[str, str]) -> str:
    return "".join(f"; left out is {place}: {why}" for place, why in left.items())


def _iteration(file: h5py.File, wanted: Any) -> tuple[h5py.Group, dict[str, Any]]:
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


def _points(
    path: Path, group: h5py.Group, place: str, record: Any, item: Any, centred: bool
) -> MeshPoints:
    """Return the points of a component; raise an error that explains why it cannot be a field."""
    geometry = text(record.attrs.get("geometry", "cartesian"))
    if geometry not in _AXES:
        raise InputError(f"geometry {geometry!r}, expected cartesian or thetaMode")
    constant, fortran = "value" in item.attrs, text(record.attrs.get("dataOrder")) == "F"
    dtype = _dtype(item)
    if dtype.kind not in "fiub":
        raise InputError(f"values of type {dtype}, expected real numbers")
    labels = [text(label).lower() for label in np.ravel(record.attrs.get("axisLabels", ()))]
    if sorted(labels) != sorted(_AXES[geometry]):
        raise InputError(f"axes {labels}, expected {list(_AXES[geometry])} in any order")
    counts = item.attrs.get("shape", ()) if constant else data_set(path, group, place).shape
    shape = tuple(int(n) for n in np.ravel(counts))
    # Lists follow the writer's index order, which for Fortran is the reverse of HDF5's. Some
    # writers give the shape of constants in HDF5's order: compare with the other components.
    if constant and fortran and shape not in {getattr(o, "shape", 0) for o in record.values()}:
        shape = shape[::-1]
    if len(shape) != 3 or min(shape) < 1 or (geometry == "thetaMode" and shape[0] % 2 == 0):
        raise FileFormatError(f"shape {shape}, expected that of a {geometry} mesh")
    along, count = np.argsort(labels), len(labels)
    holder = item if "position" in item.attrs else record
    position = 0.5 if centred else _numbers(holder, "position", count)[along]
    spacing = _numbers(record, "gridSpacing", count)[along]
    low = _numbers(record, "gridGlobalOffset", count)[along] + (position - 0.5) * spacing
    is_length = "gridUnitSI" in record.attrs
    scale = _numbers(record, "gridUnitSI", count)[along] if is_length else 1.0
    dimension = np.ravel(record.attrs.get("gridUnitDimension", _LENGTH * count))
    if not (spacing * scale > 0).all() or not np.array_equal(dimension, _LENGTH * count):
        raise InputError(f"spacings {spacing.tolist()}, expected lengths above zero")
    axes = "".join(labels[::-1] if fortran else labels)
    return MeshPoints(geometry, axes, shape, tuple(low * scale), tuple(spacing * scale), is_length)


def _dtype(item: Any) -> np.dtype:
    return np.asarray(item.attrs["value"]).dtype if "value" in item.attrs else item.dtype


def _numbers(item: Any, name: str, count: int) -> np.ndarray:
    values = np.ravel(item.attrs.get(name, ()))
    if name == "position" and len(values) == 3:
        values = values[-count:]  # some writers add one for the modes
    sound = values.dtype.kind in "fiu" and len(values) in (1, count) and np.isfinite(values).all()
    if not sound or (len(values) < count and name != "gridUnitSI"):
        raise FileFormatError(f"{name} {values.tolist()}, expected {count} numbers")
    return np.broadcast_to(values.astype(np.float64), count)


def _field(
    path: Path, name: str, part: str, record: Any, item: Any, points: MeshPoints, azimuths: Any
) -> StoredField:
    around = points.geometry == "thetaMode"
    factor, unit = 1.0, None
    if "unitSI" in item.attrs:
        factor = float(_numbers(item, "unitSI", 1)[0])
        unit = _unit(record.attrs.get("unitDimension", ()))
    sign = -1 if "imag=-" in text(record.attrs.get("geometryParameters")) else 1
    ending = _AROUND.get(part, part) if around else part
    dtype = _dtype(item).newbyteorder("=") if factor == 1 and not around else np.dtype("f8")

    def load() -> np.ndarray:
        walls = points.azimuths(azimuths) if around else np.zeros(0)
        count = int(np.prod(points.shape[1:])) * max(points.shape[0], len(walls))
        check_memory(8 * count, f"reading {place}", "take fewer azimuths, or a coarser mesh")
        with opened(path) as file:
            values: np.ndarray
            item = file[item_name]
            constant = np.ravel(item.attrs.get("value", ()))
            values = np.full(points.shape, constant[0]) if len(constant) else read(item)
        values = values if factor == 1 else values * factor
        if not around:
            values = values.transpose([points.axes.index(a) for a in "xyz"])
            return values
        values = values.transpose(0, *(1 + points.axes.index(a) for a in "rz")).astype(np.float64)
        # F = Re₀ + Σ Reₘ cos(m θ) ± Imₘ sin(m θ), stored as Re₀, Re₁, Im₁, Re₂ …
        angles = (walls[1:] + walls[:-1]) / 2
        waves = [np.ones_like(angles)]
        for m in range(1, points.shape[0] // 2 + 1):
            waves += [np.cos(m * angles), sign * np.sin(m * angles)]
        values = np.einsum("mrz,mp->rpz", values, np.array(waves), optimize=True)
        return values

    place, item_name = f"{name}/{part}".rstrip("/"), item.name
    called = field_name(f"{name}_{ending}" if part else name)
    return StoredField(called, place, points.shape, dtype, unit, load)


def _unit(powers: Any) -> UnitLike:
    from astropy import units as u

    base = u.dimensionless_unscaled
    for name, power in zip(_SI, np.ravel(powers).tolist(), strict=False):
        base = base * u.Unit(name) ** power if power else base
    named = (u.Unit(name) for name in _NAMED)
    return next((unit for unit in named if unit.decompose() == base), base)


def _grid(points: MeshPoints, unit: UnitLike, azimuths: Any) -> CartesianGrid | CylindricalGrid:
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
        return CartesianGrid.uniform(counts, ends, unit=unit)
    R, z = (a + w * np.arange(n + 1) for a, w, n in zip(low, width, counts, strict=True))
    if R[0] < -0.51 * width[0]:
        raise InputError(f"radii begin at {R[0] + width[0] / 2:.6g}, expected zero or more")
    return CylindricalGrid(np.maximum(R, 0), points.azimuths(azimuths), z, unit=unit)
