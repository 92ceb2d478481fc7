"""HDF5 snapshots as Gadget, AREPO, GIZMO and SWIFT write them."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...units import parse_unit
from ..contract import FieldInfo, Reader
from ..hdf5 import MAGIC, holds
from .columns import OPTIONS, Density, placed, volume_of
from .gadget_header import first_file
from .gadget_snapshot import Snapshot

if TYPE_CHECKING:
    from ...particles import Deposit
    from ...volume import Volume

_UNITS = ("length_unit", "mass_unit", "velocity_unit")


class GadgetReader(Reader):
    """Particles of one type, placed on an octree.

    With smoothing lengths they are smoothed by the code's kernel; without, but with volumes or
    densities, they are the cells of a mesh; else they get smoothing lengths of their own.
    """

    name = "gadget"
    description = "a snapshot of Gadget, AREPO, GIZMO or SWIFT (HDF5)"
    suffixes = (".hdf5",)
    options = {  # noqa: RUF012 - as in Reader
        **OPTIONS,
        "particle_type": "0 or 'gas' (by default), 1 or 'dark_matter', 4 or 'stars' …",
        "length_unit": "the code's unit of length, where the file does not tell",
        "mass_unit": "the code's unit of mass",
        "velocity_unit": "the code's unit of velocity",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        first = first_file(path)
        types = {f"PartType{k}" for k in range(7)}
        start = head if first == path else MAGIC
        return holds(first, start, lambda file: "Header" in file and types & set(file))

    def read(
        self,
        path: Path,
        fields: Any = None,
        *,
        particle_type: Any = 0,
        empty: float = 0.0,
        unit: Any = None,
        length_unit: Any = None,
        mass_unit: Any = None,
        velocity_unit: Any = None,
        **placing: Any,
    ) -> Volume:
        snapshot = Snapshot(path, particle_type, (length_unit, mass_unit, velocity_unit))
        make = functools.partial(_deposit, snapshot, unit, placing)
        volume = volume_of(make, _density(snapshot), snapshot.columns(), fields, empty)
        volume.meta.update(snapshot.header.meta)
        if snapshot.left_out:
            volume.meta["left_out"] = snapshot.left_out
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        length, mass, velocity = (options.get(name) for name in _UNITS)
        snapshot = Snapshot(path, options.get("particle_type", 0), (length, mass, velocity))
        columns = snapshot.columns()
        return (_density(snapshot).info, *(column.info for column in columns))


def _density(snapshot: Snapshot) -> Density:
    known = snapshot.header.units.known
    for common in ("density", "mass"):
        if common in snapshot.data:
            item = snapshot.items[snapshot.data[common]]
            return Density(snapshot.place(common), item.shape, str(item.dtype), known)
    return Density("Header/MassTable", snapshot.header.masses.shape, "float64", known)


def _deposit(snapshot: Snapshot, unit: Any, placing: dict[str, Any]) -> Deposit:
    points, box = snapshot.scaled("coordinates"), snapshot.box()
    sizes = _sizes(snapshot)
    if placing.get("bounds") is None and box is not None:
        fitting = bool(((points >= 0 * box) & (points <= box)).all())
        if fitting and (snapshot.header.periodic or {"volume", "density"} & sizes.keys()):
            placing = placing | {"bounds": [[0 * b, b] for b in box]}
            placing["periodic"] = snapshot.header.periodic
    return placed(points, snapshot.masses(), parse_unit(unit), **sizes, **placing)


def _sizes(snapshot: Snapshot) -> dict[str, Any]:
    if "smoothing_length" in snapshot.data:
        from ...particles import get_kernel

        name, radius = snapshot.kernel
        h = snapshot.scaled("smoothing_length") * (radius / get_kernel(name).support)
        return {"smoothing_length": h, "kernel": name}
    for common in ("volume", "density"):
        if common in snapshot.data:
            return {common: snapshot.scaled(common)}
    return {}
