"""Planes through a volume for the page's three panes: values, and what the document says."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np

from ..errors import InputError
from ..grids.structured import is_structured
from ..io.guard import placed
from ..scene.kinds import BOOLEAN, EXPRESSION, NUMBERS, TEXT, Kind, check_keys
from ..volume import Volume
from .painter import at_hand

_KINDS: dict[str, Kind] = {
    **dict.fromkeys(("expr", "labels"), EXPRESSION),
    **dict.fromkeys(("at", "window"), NUMBERS),
    "colormap": TEXT,
    "shown": BOOLEAN,
    "log": BOOLEAN,
}
_LENGTHS = {"at": 3, "window": 2}
# Types of whole numbers, which are sent as they are.
_WHOLE = ("u1", "<i2", "<u2")
# Values compared first: where fractions occur, most often one is among these.
_FIRST = 1000


def check_slices(slices: Any) -> None:
    """Check a description of the three panes.

    ``expr`` is shown, ``window`` (least and largest value) in a ``colormap``, at the point ``at``,
    with the field ``labels`` above; ``shown`` opens the panes.
    """
    with placed("slices"):
        if not isinstance(slices, dict):
            raise InputError(f"expected a table, got {slices!r:.200}")
        check_keys(slices, _KINDS)
        for key, value in slices.items():
            _KINDS[key](key, value)
            if len(np.atleast_1d(value)) != _LENGTHS.get(key, 1):
                raise InputError(
                    f"{key} must be {_LENGTHS.get(key, 1)} numbers, got {value!r:.200}"
                )


def of_planes(volume: Volume) -> Volume:
    """Return what slices are cut from: all cells where a plane of them is read from the file."""
    return volume if is_structured(volume.grid) else at_hand(volume)


def coded(values: np.ndarray) -> tuple[str, bytes]:
    """Return the type and the bytes of values, exactly, as a zlib stream; NaN where there are none.

    Whole numbers take a byte or two, as in the file of most scanners: 0.2 instead of 1 MiB. Others
    are packed, not compressed: 30 ms of 512² numbers for a tenth of their bytes.
    """
    kind = _whole(values)
    if kind is None:
        kind = "<f4" if np.array_equal(values.astype("<f4"), values, equal_nan=True) else "<f8"
    data = np.ascontiguousarray(values.astype(kind)).tobytes()
    return kind, zlib.compress(data, 0 if kind[1] == "f" else 1)


def _whole(values: np.ndarray) -> str | None:
    """Return the type that holds whole numbers; None if they are no such numbers."""
    for some in (values.ravel()[:_FIRST], values):
        if not np.array_equal(some, np.rint(some)):
            return None
    low, high = values.min(), values.max()
    types = ((name, np.iinfo(name)) for name in _WHOLE)
    return next((name for name, ends in types if ends.min <= low and high <= ends.max), None)
