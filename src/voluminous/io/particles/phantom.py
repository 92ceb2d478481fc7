"""Reader for dumps of the SPH code Phantom, native and HDF5."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, unknown_name
from ..contract import FieldInfo
from ..hdf5 import MAGIC, data_set, data_sets, holds, is_hdf5, opened, read
from ..names import field_name
from ..payload import mapped
from .common import (
    DENSITY_UNIT,
    OPTIONS,
    ParticleColumn,
    ParticleFile,
    ParticleReader,
    with_unit,
)
from .phantom_dump import DumpArray, byte_order, read_dump

if TYPE_CHECKING:
    import h5py

# Particle types in Phantom's numbering.
TYPES = {"gas": 1, "boundary": 3, "star": 4, "dark_matter": 5, "bulge": 6, "dust": 7}
_VECTORS = {"xyz": "", "vxyz": "v", "Bxyz": "B"}
# Header names of the particle masses by type: the name in Phantom, and the name in copies.
_MASS = ("massoftype", "mass")
# Common names; powers of the code's length, mass and time; and the output unit.
_KNOWN: dict[str, tuple[str, tuple[int, int, int], str]] = {
    **{f"v{axis}": (f"velocity_{axis}", (1, 0, -1), "km / s") for axis in "xyz"},
    "u": ("internal_energy", (2, 0, -2), "km2 / s2"),
    "h": ("smoothing_length", (1, 0, 0), "cm"),
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
        return PhantomParticles(_contents(path), **options)


@dataclass(frozen=True)
class PhantomColumn:
    """One scalar per particle: its place, its description, and a function that reads it."""

    place: str
    shape: tuple[int, ...]
    dtype: np.dtype
    load: Callable[[], np.ndarray]


@dataclass(frozen=True)
class PhantomContents:
    """The contents of a native or HDF5 dump, without particle values."""

    header: dict[str, np.ndarray]  # all header numbers by tag
    particles: dict[str, PhantomColumn]  # by Phantom's tags, vectors as components: x, vx, Bx …
    sinks: dict[str, PhantomColumn]
    mass_place: str
    left_out: dict[str, str]  # reasons why other data sets cannot be fields


class PhantomParticles(ParticleFile):
    """The live particles of one type."""

    def __init__(self, dump: PhantomContents, particle_type: Any = 1) -> None:
        self.dump, self.header = dump, dump.header
        units = tuple(self._number(tag, 0.0) for tag in ("udist", "umass", "utime"))
        self.units = units if min(units) > 0 else None  # length, mass and time in cgs
        self.kind = TYPES.get(particle_type, particle_type)
        masses = self.header.get("massoftype", np.zeros(0))
        if not isinstance(self.kind, int) or not 1 <= self.kind <= len(masses):
            raise unknown_name("particle type", str(particle_type), TYPES)
        unit = DENSITY_UNIT if self.units else ""
        shape = dump.particles["h"].shape
        self.density = FieldInfo("density", dump.mass_place, shape, "float64", unit)
        self.meta = self._meta()

    def _meta(self) -> dict[str, Any]:
        """Return the time, and the sinks in code units under Phantom's names."""
        factor, unit = self._factor((0, 0, 1), "s")
        meta: dict[str, Any] = {"code": "Phantom", "time": self._number("time", 0.0) * factor}
        meta |= {"time_unit": "s"} if unit else {}
        meta |= {"left_out": self.dump.left_out} if self.dump.left_out else {}
        if any(item.shape[0] for item in self.dump.sinks.values()):
            meta["sinks"] = {tag: item.load().tolist() for tag, item in self.dump.sinks.items()}
        if self.units is not None:
            meta["code_units"] = dict(zip(("cm", "g", "s"), self.units, strict=True))
        return meta

    def _number(self, tag: str, default: float) -> float:
        value = float(self.header[tag][0]) if tag in self.header else default
        if not np.isfinite(value):
            raise FileFormatError(f"the header has no number {tag!r}")
        return value

    @functools.cached_property
    def live(self) -> np.ndarray:
        """Mask of the particles that have the type and are not accreted."""
        columns = self.dump.particles
        live = np.asarray(columns["h"].load() > 0)
        if "itype" in columns:
            live &= np.abs(columns["itype"].load()) == self.kind
        elif self.kind != 1:
            live[:] = False
        if not live.any():
            raise FileFormatError(f"there are no live particles of type {self.kind}")
        return live

    def _values(self, tag: str, factor: float = 1.0) -> np.ndarray:
        return self.dump.particles[tag].load()[self.live].astype(np.float64) * factor

    def points(self) -> Any:
        return self._scaled(np.stack([self._values(a) for a in "xyz"], axis=1), (1, 0, 0), "cm")

    def sizes(self) -> dict[str, Any]:
        return {"smoothing_length": self._scaled(self._values("h"), (1, 0, 0), "cm")}

    def masses(self) -> Any:
        mass = float(self.header["massoftype"][self.kind - 1])
        if not 0 < mass < np.inf:
            raise FileFormatError(f"massoftype of type {self.kind} is {mass}, expected more than 0")
        masses = np.full(np.count_nonzero(self.live), mass)
        if "apr_level" in self.dump.particles:  # split particles: masses smaller by powers of two
            masses *= np.exp2(1 - self._values("apr_level"))
        return self._scaled(masses, (0, 1, 0), "g")

    def _scaled(self, values: np.ndarray, powers: tuple[int, int, int], unit: str) -> Any:
        factor, own = self._factor(powers, unit)
        return with_unit(values * factor, own)

    def _factor(self, powers: tuple[int, int, int], unit: str) -> tuple[float, str]:
        """Return (factor, unit) to convert from code units; (1, "") without code units."""
        if self.units is None:
            return 1.0, ""
        from astropy import units as u

        cgs = u.cm ** powers[0] * u.g ** powers[1] * u.s ** powers[2]
        value = float(np.prod([base**p for base, p in zip(self.units, powers, strict=True)]))
        return value * float(cgs.to(u.Unit(unit))), unit

    def columns(self) -> list[ParticleColumn]:
        """Return all real columns except the positions."""
        found = []
        for tag, item in self.dump.particles.items():
            if item.dtype.kind == "f" and tag not in ("x", "y", "z"):
                name, factor, unit = self._described(tag)
                load = functools.partial(self._values, tag, factor)
                info = FieldInfo(name, item.place, item.shape, str(item.dtype), unit)
                found.append(ParticleColumn(info, load))
        return found

    def _described(self, tag: str) -> tuple[str, float, str]:
        if tag in _KNOWN:
            name, powers, unit = _KNOWN[tag]
            return name, *self._factor(powers, unit)
        if tag in ("Bx", "By", "Bz"):
            gauss = self._number("umagfd", 0.0)
            return f"magnetic_field_{tag[1]}", gauss or 1.0, "G" if gauss else ""
        if tag in ("T", "temperature"):
            return "temperature", 1.0, "K"
        return field_name(tag), 1.0, ""


def _contents(path: Path) -> PhantomContents:
    with open(path, "rb") as file:
        in_hdf5 = file.read(len(MAGIC)) == MAGIC
    found = _in_hdf5(path) if in_hdf5 else _native(path)
    for tag in ("x", "y", "z", "h"):
        if tag not in found.particles:
            raise FileFormatError(f"particles have no {tag!r}; they have {list(found.particles)}")
    return found


def _native(path: Path) -> PhantomContents:
    dump = read_dump(path)
    particles, sinks = (
        {
            tag: PhantomColumn(
                tag,
                (array.count,),
                array.dtype.newbyteorder("="),
                functools.partial(_load_native, path, array),
            )
            for tag, array in arrays.items()
        }
        for arrays in (dump.particles, dump.sinks)
    )
    return PhantomContents(dump.header, particles, sinks, "massoftype", {})


def _load_native(path: Path, array: DumpArray) -> np.ndarray:
    if not array.count:
        return np.empty(0, array.dtype)
    return mapped(path, array.offset, (array.count,), array.dtype)


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
) -> tuple[dict[str, PhantomColumn], dict[str, str]]:
    """Return the columns of the data sets in a group, and why other data sets have none."""
    found: dict[str, PhantomColumn] = {}
    items, left_out = data_sets(path, group)
    for name, item in items.items():
        place, shape = item.name.strip("/"), item.shape
        if len(shape) not in (1, 2) or shape[0] != (count or shape[0]):
            left_out[name] = f"shape {shape}, expected a row of numbers for each particle"
        elif len(shape) == 1:
            load = functools.partial(_load, path, place)
            found[name] = PhantomColumn(place, shape, item.dtype, load)
        else:
            endings = "xyz" if shape[1] == 3 else [f"{k}" for k in range(shape[1])]
            stem = _VECTORS.get(name, f"{name}_")
            for k, ending in enumerate(endings):
                load = functools.partial(_load, path, place, k)
                tag = stem + ending if shape[1] > 1 else name
                found[tag] = PhantomColumn(f"{place}[{k}]", shape, item.dtype, load)
    return found, left_out


def _load(path: Path, place: str, column: int | None = None) -> np.ndarray:
    group, _, name = place.rpartition("/")
    with opened(path) as file:
        return read(data_set(path, file[group], name), column)
