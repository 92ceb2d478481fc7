"""An array in a file: what is known of it before it is read, and how to read it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import InputError
from ..axis_names import axis_of

# More are no components of a vector, but a fourth dimension.
_MOST = 4
_WHERE = {"first": 0, "last": 3}


@dataclass(frozen=True)
class Entry:
    """An array in a file.

    Attributes
    ----------
    shape, dtype, unit
        Known without reading it.
    load : callable
        Returns the values, or the part with an index.
    mapped : bool
        True if values stay in the file until they are used.
    scales, dims : tuple of str
        Per axis the place of its coordinate and its name, empty where there is none; or nothing.
    part_of : str
        Place of the array that this is a component of; empty if it is whole.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    unit: str
    load: Callable[..., np.ndarray]
    mapped: bool = False
    scales: tuple[str, ...] = ()
    dims: tuple[str, ...] = ()
    part_of: str = ""

    @property
    def numeric(self) -> bool:
        """True for real numbers."""
        return self.dtype.kind in "fiub"

    def component(self, place: str, axis: int, number: int) -> Entry:
        """Return one entry along an axis; the place is that of the whole array."""
        index = (*[slice(None)] * axis, number)
        without = [k for k in range(len(self.shape)) if k != axis]
        return replace(
            self,
            shape=tuple(self.shape[k] for k in without),
            load=lambda: self.load(index),
            mapped=False,
            scales=tuple(self.scales[k] for k in without) if self.scales else (),
            dims=tuple(self.dims[k] for k in without) if self.dims else (),
            part_of=place,
        )


def with_components(entries: Mapping[str, Entry], where: Any) -> dict[str, Entry]:
    """Return all arrays, those of vectors (of four axes) as one for each component.

    Parameters
    ----------
    entries : mapping
        Place → array.
    where : {None, "first", "last"}
        Which axis counts components; None: the only one of the two that has three, or else 2 to 4
        entries.

    Returns
    -------
    dict
        The components of ``velocity`` are ``velocity_x``, ``velocity_y`` and ``velocity_z`` if
        there are three, else ``velocity_0`` …

    Raises
    ------
    InputError
        If `where` is anything else.
    """
    if where is not None and where not in _WHERE:
        raise InputError(f"components must be 'first' or 'last', got {where!r}")
    found: dict[str, Entry] = {}
    for place, entry in entries.items():
        axis = _component_axis(entry, where)
        if axis is None:
            found[place] = entry
            continue
        count = entry.shape[axis]
        endings = "xyz" if count == len("xyz") else map(str, range(count))
        for number, ending in enumerate(endings):
            found.setdefault(f"{place}_{ending}", entry.component(place, axis, number))
    return found


def _component_axis(entry: Entry, where: str | None) -> int | None:
    if len(entry.shape) != 4 or not entry.numeric:
        return None
    if where is not None:
        return _WHERE[where]
    # An axis that is called x, y, z or t counts no components.
    ends = [a for a in _WHERE.values() if not (entry.dims and axis_of(entry.dims[a], {}))]
    three = [axis for axis in ends if entry.shape[axis] == 3]
    few = [axis for axis in ends if 2 <= entry.shape[axis] <= _MOST]
    return next((found[0] for found in (three, few) if len(found) == 1), None)
