"""Reader for dumps of the SPH code Phantom, native and HDF5."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...errors import FileFormatError, unknown_name
from ..contract import StoredField
from ..hdf5 import data_set, data_sets, holds, is_hdf5, opened, read
from ..names import field_name
from ..units import TIME, CodeUnits, Quantity
from .common import DENSITY_UNIT, OPTIONS, ParticleFile, ParticleReader, with_unit
from .phantom_dump import byte_order, read_dump

if TYPE_CHECKING:
    import h5py

# Particle types in Phantom's numbering.
TYPES = {"gas": 1, "boundary": 3, "star": 4, "dark_matter": 5, "bulge": 6, "dust": 7}
_VECTORS = {"xyz": "", "vxyz": "v", "Bxyz": "B"}
# Header names of the particle masses by type: the name in Phantom, and the name in copies.
_MASS = ("massoftype", "mass")
_LENGTH = Quantity("smoothing_length", (1, 0, 0), "cm")
_KNOWN = {
    **{f"v{axis}": Quantity(f"velocity_{axis}", (1, 0, -1), "km / s") for axis in "xyz"},
    "u": Quantity("internal_energy", (2, 0, -2), "km2 / s2"),
    "h": _LENGTH,
}


class PhantomReader(ParticleReader):
    """Live particles of one type, smoothed by their kernel on an octree; sinks are in `meta`."""

    name = "phantom"
    description = "a dump of Phantom"
    opening = ("particle_type",)
    options = {  # noqa: RUF012 - as in Reader
        **OPTIONS,
        "particle_type": "1 or 'gas' (by default), 7 or 'dust', 3 or 'boundary' …",
        "kernel": "the kernel that Phantom was compiled with ('cubic')",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return holds(path, head, _is_dump) if is_hdf5(head) else byte_order(head) is not None

    def particles(self, path: Path, **options: Any) -> PhantomParticles:
        with open(path, "rb") as file:
            in_hdf5 = is_hdf5(file.read(8))
        return PhantomParticles(_in_hdf5(path) if in_hdf5 else _native(path), **options)


# Fields by Phantom's tags, vectors as components: x, vx, Bx …
Columns = dict[str, StoredField]


class PhantomContents(NamedTuple):
    """The contents of a native or HDF5 dump, without particle values."""

    header: dict[str, np.ndarray]
    particles: Columns
    sinks: Columns
    mass_place: str
    left_out: dict[str, str]  # reasons why other data sets cannot be fields


class PhantomParticles(ParticleFile):
    """The live particles of one type."""

    def __init__(self, dump: PhantomContents, particle_type: Any = 1) -> None:
        self.header, self.columns, sinks, mass_place, left_out = dump
        for tag in ("x", "y", "z", "h"):
            if tag not in self.columns:
                raise FileFormatError(f"particles have no {tag!r}; they have {[*self.columns]}")
        self.kind = TYPES.get(particle_type, particle_type)
        masses = self.header.get("massoftype", np.zeros(0))
        if not isinstance(self.kind, int) or not 1 <= self.kind <= len(masses):
            raise unknown_name("particle type", str(particle_type), TYPES)
        sizes = [self._number(tag) for tag in ("udist", "umass", "utime")]
        self.units = CodeUnits()
        self.meta: dict[str, Any] = {"code": "Phantom", "time": self._number("time")}
        if min(sizes) > 0:
            from astropy import units as u

            self.meta["code_units"] = dict(zip(("cm", "g", "s"), sizes, strict=True))
            units = self.meta["code_units"].items()
            self.units = CodeUnits(*(u.Unit(size * u.Unit(cgs)) for cgs, size in units))
            self.meta |= {"time": self.meta["time"] * self.units.of(TIME)[0], "time_unit": "s"}
        self.meta |= {"left_out": left_out} if left_out else {}
        if any(item.shape[0] for item in sinks.values()):  # in code units
            self.meta["sinks"] = {tag: item.load().tolist() for tag, item in sinks.items()}
        unit, shape = DENSITY_UNIT if min(sizes) > 0 else "", self.columns["h"].shape
        self.fields = [StoredField("density", mass_place, shape, np.dtype("f8"), unit, self.masses)]
        for tag, item in self.columns.items():
            if item.dtype.kind == "f" and tag not in ("x", "y", "z"):
                name, factor, unit = self._described(tag)
                load = functools.partial(self._values, tag, factor)
                self.fields.append(
                    StoredField(name, item.place, item.shape, item.dtype, unit, load)
                )

    def _number(self, tag: str) -> float:
        value = float(self.header[tag][0]) if tag in self.header else 0.0
        if not np.isfinite(value):
            raise FileFormatError(f"the header has no number {tag!r}")
        return value

    def _described(self, tag: str) -> tuple[str, float, str]:
        if tag in _KNOWN:
            return _KNOWN[tag].name, *self.units.of(_KNOWN[tag])
        if tag in ("Bx", "By", "Bz"):
            gauss = self._number("umagfd")
            return f"magnetic_field_{tag[1]}", gauss or 1.0, "G" if gauss else ""
        known = tag in ("T", "temperature")
        return ("temperature", 1.0, "K") if known else (field_name(tag), 1.0, "")

    @functools.cached_property
    def live(self) -> np.ndarray:
        """Mask of the particles that have the type and are not accreted."""
        live = np.asarray(self.columns["h"].load() > 0)
        if "itype" in self.columns:
            live &= np.abs(self.columns["itype"].load()) == self.kind
        elif self.kind != 1:
            live[:] = False
        if not live.any():
            raise FileFormatError(f"there are no live particles of type {self.kind}")
        return live

    def _values(self, tag: str, factor: float = 1.0) -> np.ndarray:
        values: np.ndarray = self.columns[tag].load()[self.live].astype(np.float64)
        return values * factor

    def points(self) -> Any:
        return self._scaled(np.stack([self._values(a) for a in "xyz"], axis=1), _LENGTH)

    def sizes(self) -> dict[str, Any]:
        return {"smoothing_length": self._scaled(self._values("h"), _LENGTH)}

    def masses(self) -> Any:
        mass = float(self.header["massoftype"][self.kind - 1])
        if not 0 < mass < np.inf:
            raise FileFormatError(f"massoftype of type {self.kind} is {mass}, expected more than 0")
        masses = np.full(np.count_nonzero(self.live), mass)
        if "apr_level" in self.columns:  # split particles: masses smaller by powers of two
            masses *= np.exp2(1 - self._values("apr_level"))
        return self._scaled(masses, Quantity("mass", (0, 1, 0), "g"))

    def _scaled(self, values: np.ndarray, quantity: Quantity) -> Any:
        factor, unit = self.units.of(quantity)
        return with_unit(values * factor, unit)


def _native(path: Path) -> PhantomContents:
    dump = read_dump(path)
    return PhantomContents(*dump, "massoftype", {})


def _is_dump(file: h5py.File) -> bool:
    if "header" not in file or "particles" not in file:
        return False
    tags = {*file["header"], *file["header"].attrs}
    return {"xyz", "h"} <= set(file["particles"]) and {"hfact", "udist"} <= tags


def _in_hdf5(path: Path) -> PhantomContents:
    with opened(path) as file:
        if not _is_dump(file):
            raise FileFormatError("expected groups 'header' and 'particles' as Phantom writes them")
        header = {name: np.ravel(value) for name, value in file["header"].attrs.items()}
        header |= {n: np.ravel(read(d)) for n, d in data_sets(path, file["header"])[0].items()}
        header = {n: v for n, v in header.items() if v.size and v.dtype.kind in "fiu"}
        mass = next((name for name in _MASS if name in header), None)
        if mass is None:
            raise FileFormatError("the header has no massoftype")
        header["massoftype"] = header[mass]
        particles, left_out = _columns_in(path, file["particles"], file["particles/h"].size)
        sinks = _columns_in(path, file["sinks"])[0] if "sinks" in file else {}
    return PhantomContents(header, particles, sinks, f"header/{mass}", left_out)


def _columns_in(
    path: Path, group: h5py.Group, count: int | None = None
) -> tuple[Columns, dict[str, str]]:
    columns: Columns = {}
    items, left_out = data_sets(path, group)
    for name, item in items.items():
        place, shape = item.name.strip("/"), item.shape
        load = functools.partial(_load, path, place)
        if len(shape) not in (1, 2) or shape[0] != (count or shape[0]):
            left_out[name] = f"shape {shape}, expected a row of numbers for each particle"
        elif len(shape) == 1:
            columns[name] = StoredField(name, place, shape, item.dtype, "", load)
        else:
            endings = "xyz" if shape[1] == 3 else [f"{k}" for k in range(shape[1])]
            for k, ending in enumerate(endings):
                tag = _VECTORS.get(name, f"{name}_") + ending if shape[1] > 1 else name
                columns[tag] = StoredField(
                    tag, f"{place}[{k}]", shape, item.dtype, "", functools.partial(load, k)
                )
    return columns, left_out


def _load(path: Path, place: str, column: int | None = None) -> np.ndarray:
    group, _, name = place.rpartition("/")
    with opened(path) as file:
        return read(data_set(path, file[group], name), column)
