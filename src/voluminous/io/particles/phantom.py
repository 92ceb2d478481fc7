"""Dumps of Phantom, an SPH code: native ones, and in HDF5."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from ...units import parse_unit
from ..contract import FieldInfo, Reader
from ..hdf5 import MAGIC, holds, is_hdf5
from ..payload import mapped
from .columns import OPTIONS, placed, volume_of
from .phantom_columns import columns_of, density_of
from .phantom_dump import Array, byte_order, read_dump
from .phantom_hdf5 import is_dump, source_in
from .phantom_source import Property, Source

if TYPE_CHECKING:
    from ...particles import Deposit
    from ...volume import Volume


class PhantomReader(Reader):
    """Live particles of one type, smoothed by their kernel on an octree; sinks are in `meta`."""

    name = "phantom"
    description = "a dump of Phantom"
    options = {  # noqa: RUF012 - as in Reader
        **OPTIONS,
        "particle_type": "1 or 'gas' (by default), 7 or 'dust', 3 or 'boundary' …",
        "kernel": "the kernel that Phantom was compiled with ('cubic')",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return holds(path, head, is_dump) if is_hdf5(head) else byte_order(head) is not None

    def read(
        self,
        path: Path,
        fields: Any = None,
        *,
        particle_type: Any = 1,
        empty: float = 0.0,
        unit: Any = None,
        **placing: Any,
    ) -> Volume:
        source = _source(path)
        source.choose(particle_type)
        make = functools.partial(_deposit, source, unit, placing)
        volume = volume_of(make, density_of(source), columns_of(source), fields, empty)
        volume.meta.update(_meta(source))
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        source = _source(path)
        columns = columns_of(source)
        return (density_of(source).info, *(column.info for column in columns))


def _source(path: Path) -> Source:
    with open(path, "rb") as file:
        if file.read(len(MAGIC)) == MAGIC:
            return source_in(path)
    dump = read_dump(path)
    particles, sinks = (
        {tag: _property(path, tag, array) for tag, array in arrays.items()}
        for arrays in (dump.particles, dump.sinks)
    )
    for tag in ("x", "y", "z", "h"):
        if tag not in particles:
            raise FileFormatError(f"particles have no {tag!r}; they have {', '.join(particles)}")
    return Source(dump.header, particles, sinks, "massoftype", {})


def _property(path: Path, tag: str, array: Array) -> Property:
    load = functools.partial(_load, path, array)
    return Property(tag, (array.count,), array.dtype.newbyteorder("="), load)


def _load(path: Path, array: Array) -> np.ndarray:
    if not array.count:
        return np.empty(0, array.dtype)
    return mapped(path, array.offset, (array.count,), array.dtype)


def _deposit(source: Source, unit: Any, placing: dict[str, Any]) -> Deposit:
    return placed(
        source.points(),
        source.masses(),
        parse_unit(unit),
        smoothing_length=source.lengths(),
        **placing,
    )


def _meta(source: Source) -> dict[str, Any]:
    """Return the time, and the sinks: their numbers by Phantom's names, in the code's units."""
    factor, unit = source.factor((0, 0, 1), "s")
    meta: dict[str, Any] = {"code": "Phantom", "time": source.number("time", 0.0) * factor}
    if unit is not None:
        meta["time_unit"] = "s"
    if source.left_out:
        meta["left_out"] = source.left_out
    if any(item.shape[0] for item in source.sinks.values()):
        meta["sinks"] = {tag: item.load().tolist() for tag, item in source.sinks.items()}
    if source.units is not None:
        meta["code_units"] = dict(zip(("cm", "g", "s"), source.units, strict=True))
    return meta
