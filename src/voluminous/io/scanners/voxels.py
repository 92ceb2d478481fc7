"""What readers of voxels share: from what the head of a file tells to a volume."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import InputError
from ..channels import Channel, channel_fields, channel_meta
from ..contract import FieldInfo, Reader
from ..names import chosen_fields, field_name
from .placement import LPS, SIGNS, Arrangement, Placement, arranged

if TYPE_CHECKING:
    from ...volume import Volume

VECTOR = ("_x", "_y", "_z")
COLORS = ("_red", "_green", "_blue", "_alpha")
# Endings that belong to the format or its packing, not to the name of what is in the file.
_PACKINGS = (".gz", ".bz2", ".xz")
_DOUBLE = (".nii", ".ome", ".img", ".hdr")


@dataclass(frozen=True)
class Voxels:
    """What the head of a file tells of the voxels in it."""

    shape: tuple[int, ...]  # voxels along the axes of the array, the fastest in the file first
    dtype: np.dtype[Any]  # of what `load` returns
    placement: Placement  # where they are
    # reads one component, by its number, as an array of this shape
    load: Callable[[int], np.ndarray]
    # what is put behind the field's name for each component: ``("",)`` for scalars, `VECTOR` for
    # vectors in the coordinates that the placement is in
    components: tuple[str, ...] = ("",)
    # of the field, where the file or its format tells better than the file's own name
    name: str = ""
    unit: str = ""  # of the values
    channels: Sequence[Channel] = ()  # label, colour and window of each component, see `channels`
    # what else the volume's `meta` shall hold
    meta: Mapping[str, Any] = field(default_factory=dict)


class VoxelReader(Reader):
    """What readers of voxels share; a format has to provide `voxels`."""

    options = {  # noqa: RUF012 - as in Reader
        "name": "name of the field; by default that of the file without suffix",
    }

    def voxels(self, path: Path, *_: Any, **options: Any) -> Voxels:
        """Return what the head of a file tells; reads no values. Options are keywords."""
        raise NotImplementedError

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        from ...volume import Volume

        named = options.pop("name", None)
        voxels = self.voxels(path, **options)
        arrangement = arranged(voxels.shape, voxels.placement)
        known = _known(path, named, voxels, arrangement)
        volume = Volume(arrangement.grid)
        volume.meta |= dict(voxels.meta) | _orientation(voxels.placement, arrangement)
        entries = []
        for name, place in chosen_fields({place: place for place in known}, fields).items():
            number, sign = known[place]
            load = functools.partial(_load, voxels, arrangement, number, sign)
            volume[name] = Deferred(load, _dtype(voxels, sign), voxels.unit)
            entries.append((name, voxels.channels[number] if voxels.channels else {}))
        volume.meta |= channel_meta(entries)
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        named = options.pop("name", None)
        voxels = self.voxels(path, **options)
        arrangement = arranged(voxels.shape, voxels.placement)
        return tuple(
            FieldInfo(place, place, voxels.shape, str(_dtype(voxels, sign)), voxels.unit)
            for place, (_, sign) in _known(path, named, voxels, arrangement).items()
        )


def stem(path: Path) -> str:
    """Return the name of a file without the endings that tell its format."""
    short = path.with_suffix("") if path.suffix.lower() in _PACKINGS else path
    inner = short.with_suffix("")
    return inner.stem if inner.suffix.lower() in _DOUBLE else short.stem


def components(count: int, endings: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Return the endings of so many components: those given, as far as they go, or numbers."""
    if count <= len(endings):
        return endings[:count]
    return tuple(f"_{number}" for number in range(count))


def time_step(time: Any, count: int) -> int:
    """Return the number of a time step that a user asks for, from 0; negative from the end."""
    if isinstance(time, bool) or not isinstance(time, (int, np.integer)):
        raise InputError(f"time must be the number of a time step, from 0, got {time!r}")
    if not -count <= time < count:
        raise InputError(f"time must be from 0 to {count - 1}, got {time}")
    return int(time) % count


def _known(
    path: Path, named: str | None, voxels: Voxels, arrangement: Arrangement
) -> dict[str, tuple[int, float]]:
    """Return, by name, the numbers of the components, and the signs they are multiplied with."""
    base = named or field_name(voxels.name or stem(path))
    endings, signs = voxels.components, (1.0,) * len(voxels.components)
    if endings == VECTOR:
        signs = SIGNS[voxels.placement.space]
        # Along the coordinates, not along the grid's axes: x, y and z would promise too much.
        endings = components(len(endings)) if arrangement.direction is not None else endings
    names = [base + end for end in endings]
    names = channel_fields(() if named else voxels.channels, names)
    return {name: (k, s) for k, (name, s) in enumerate(zip(names, signs, strict=True))}


def _dtype(voxels: Voxels, sign: float) -> np.dtype[Any]:
    """Return the type of a component: one with its sign changed needs room for it."""
    return voxels.dtype if sign > 0 else np.result_type(voxels.dtype, np.float32)


def _load(voxels: Voxels, arrangement: Arrangement, number: int, sign: float) -> np.ndarray:
    values = arrangement.put(voxels.load(number))
    return values if sign > 0 else np.negative(values, dtype=_dtype(voxels, sign))


def _orientation(placement: Placement, arrangement: Arrangement) -> dict[str, Any]:
    told: dict[str, Any] = {"orientation": LPS} if placement.space else {}
    if arrangement.direction is not None:
        told["direction"] = arrangement.direction.tolist()
    return told
