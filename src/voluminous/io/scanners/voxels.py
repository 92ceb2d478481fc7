"""Code shared by the readers of voxels: converts the header of a file to a volume."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError
from ..boxes import boxes
from ..contract import FieldInfo, Reader
from ..names import chosen_fields, field_name
from .placement import LPS, SIGNS, Arrangement, Placement, arranged

if TYPE_CHECKING:
    from ...volume import Volume

VECTOR = ("_x", "_y", "_z")
# Each component becomes a field; the most that spectrometers give are thousands.
_MOST = 20_000
COLORS = ("_red", "_green", "_blue", "_alpha")
# Endings that belong to the format or its packing, not to the name of what is in the file.
_PACKINGS = (".gz", ".bz2", ".xz")
_DOUBLE = (".nii", ".ome", ".img", ".hdr")


@dataclass(frozen=True)
class Voxels:
    """The header of a file of voxels, and how to read them."""

    shape: tuple[int, ...]  # along the axes of the array, the fastest in the file first
    dtype: np.dtype[Any]  # of what `load` returns
    placement: Placement
    load: Callable[..., np.ndarray]  # reads one component, by its number, in this shape
    # Endings of the fields' names: `VECTOR` for vectors in the coordinates of the placement.
    components: tuple[str, ...] = ("",)
    name: str = ""  # of the field, where the format gives a better one than the file's name
    unit: str = ""  # of the values
    channels: Sequence[Channel] = ()  # label, colour and window of each component
    meta: Mapping[str, Any] = field(default_factory=dict)  # for the volume's `meta`
    labels: Sequence[Sequence[Any]] = ()  # tables of each component, if it is of labels
    # Cells of the pieces in the file if `load` also takes slices and a level; else empty.
    chunks: tuple[int, ...] = ()
    coarser: Sequence[tuple[int, ...]] = ()  # shapes of levels 1, 2 …


class VoxelReader(Reader):
    """Base class of readers of voxels; a format has to provide `voxels`."""

    options = {  # noqa: RUF012 - as in Reader
        "name": "name of the field; by default that of the file without suffix",
    }

    def voxels(self, path: Path, *_: Any, **options: Any) -> Voxels:
        """Return the header of a file; reads no values. Options are keywords."""
        raise NotImplementedError

    def read(
        self, path: Path, fields: Any = None, *, name: str | None = None, **options: Any
    ) -> Volume:
        from ...volume import Volume

        voxels = self.voxels(path, **options)
        arrangement, known = _arranged(path, name, voxels)
        volume = Volume(arrangement.grid)
        volume.meta |= dict(voxels.meta) | ({"orientation": LPS} if voxels.placement.space else {})
        if arrangement.direction is not None:
            volume.meta["direction"] = arrangement.direction.tolist()
        entries: list[tuple[str, Channel]] = []
        labels: dict[str, Any] = {}
        for field_, place in chosen_fields({place: place for place in known}, fields).items():
            number, sign, dtype = known[place]
            load = functools.partial(_load, voxels, arrangement, number, sign, dtype)
            pieces = None
            if voxels.chunks and sign > 0:
                read = functools.partial(voxels.load, number)
                shapes, turns = [voxels.shape, *voxels.coarser], arrangement
                pieces = boxes(read, shapes, voxels.chunks, turns.order, turns.backward)
            volume[field_] = Deferred(load, dtype, voxels.unit, pieces=pieces)
            entries.append((field_, voxels.channels[number] if voxels.channels else {}))
            if voxels.labels and voxels.labels[number]:
                labels[field_] = list(voxels.labels[number])
        volume.meta |= channel_meta(entries) | ({"labels": labels} if labels else {})
        return volume

    def info(self, path: Path, *, name: str | None = None, **options: Any) -> tuple[FieldInfo, ...]:
        voxels = self.voxels(path, **options)
        return tuple(
            FieldInfo(place, place, voxels.shape, str(dtype), voxels.unit)
            for place, (*_, dtype) in _arranged(path, name, voxels)[1].items()
        )


# Options of a format with time steps.
TIMED = {
    **VoxelReader.options,
    "time": "number of the time step or volume, from 0, of a file with several",
}


def stem(path: Path) -> str:
    """Return the name of a file without the endings of its format: without both of .nii.gz."""
    short = path.with_suffix("") if path.suffix.lower() in _PACKINGS else path
    inner = short.with_suffix("")
    return inner.stem if inner.suffix.lower() in _DOUBLE else short.stem


def component_names(count: int, endings: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Return the endings of so many components: those given, as far as they go, or numbers."""
    if count > _MOST:
        raise FileFormatError(f"it has {count} channels or components, expected {_MOST} at most")
    if count == 1:
        return ("",)
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


def times_meta(count: int, step: int) -> dict[str, Any]:
    """Return the `meta` of one of several time steps; nothing of a single one."""
    return {} if count == 1 else {"times": count, "time_step": step}


def _arranged(
    path: Path, name: str | None, voxels: Voxels
) -> tuple[Arrangement, dict[str, tuple[int, float, np.dtype[Any]]]]:
    """Return, by name, number, sign and type of the components: a sign changed needs room."""
    arrangement = arranged(voxels.shape, voxels.placement)
    base = name or field_name(voxels.name or stem(path))
    endings, signs = voxels.components, (1.0,) * len(voxels.components)
    if endings == VECTOR:
        signs = SIGNS[voxels.placement.space]
        # Along the coordinates, not along the grid's axes: x, y and z would promise too much.
        endings = component_names(3) if arrangement.direction is not None else endings
    names = channel_fields(() if name else voxels.channels, [base + end for end in endings])
    signed = np.result_type(voxels.dtype, np.float32)
    types = [voxels.dtype if sign > 0 else signed for sign in signs]
    numbered = zip(names, range(len(names)), signs, types, strict=True)
    return arrangement, {n: (k, sign, dtype) for n, k, sign, dtype in numbered}


def _load(
    voxels: Voxels, arrangement: Arrangement, number: int, sign: float, dtype: np.dtype[Any]
) -> np.ndarray:
    values = arrangement.put(voxels.load(number))
    return values if sign > 0 else np.negative(values, dtype=dtype)


Channel = dict[str, Any]
# Image rows run downwards: the volume's y axis points down on the screen, and z away.
Y_DOWN = {"y_down": True}


def channel(label: Any = "", color: Any = None, window: Any = None) -> Channel:
    """Return the entry of a channel, from three numbers from 0 to 255 and two window ends."""
    entry: Channel = {"label": str(label).strip()} if label and str(label).strip() else {}
    if color is not None and len(color) == 3:
        entry["color"] = [round(min(max(int(c), 0), 255) / 255, 4) for c in color]
    if window is not None and len(window) == 2:
        low, high = (float(v) for v in window)
        if math.isfinite(low) and math.isfinite(high) and low < high:
            entry["window"] = [low, high]
    return entry


def channel_fields(channels: Sequence[Mapping[str, Any]], numbered: Sequence[str]) -> list[str]:
    """Return the field names: channel labels, or numbered names.

    All are numbered if two labels, or the field names made from them, are equal.
    """
    labels = [str(entry.get("label", "")) for entry in channels]
    labels = (labels + [""] * len(numbered))[: len(numbered)]
    names = [field_name(t) if t else n for t, n in zip(labels, numbered, strict=True)]
    return names if len(set(names)) == len(names) else list(numbered)


def channel_meta(entries: Iterable[tuple[str, Mapping[str, Any]]]) -> dict[str, Any]:
    """Return the `meta` of fields and their channels; empty if the file gives no channel data."""
    result = {name: dict(entry) for name, entry in entries}
    return {"channels": result} if any(result.values()) else {}


def of_samples(count: int) -> list[Channel]:
    """Return entries for the samples of a pixel; three or more begin with red, green and blue."""
    primaries = [channel(color=[255 * (k == n) for k in range(3)]) for n in range(3)]
    return [*primaries, *[{}] * (count - 3)] if count > 2 else [{}] * count
