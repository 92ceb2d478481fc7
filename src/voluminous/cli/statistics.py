"""Ranges and histograms of arrays, computed in pieces so that temporary arrays stay small."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

_PIECE = 1 << 20
_BARS = " ▁▂▃▄▅▆▇█"
_WIDTH = 48
# Maximum number of values in a histogram; larger arrays are subsampled (the range is exact).
_COUNTED = 1 << 24


@dataclass
class ValueSummary:
    """Statistics of an array: numbers of values, and the range of the finite values.

    Attributes
    ----------
    positive : float
        The smallest positive value.
    first_nan, first_infinite : int or None
        Flat index of the first such value.
    """

    size: int = 0
    finite: int = 0
    nan: int = 0
    least: float = np.inf
    greatest: float = -np.inf
    positive: float = np.inf
    total: float = 0.0
    first_nan: int | None = None
    first_infinite: int | None = None

    def add(self, good: np.ndarray, total: float) -> None:
        """Add finite values and their sum."""
        least, greatest = good.min(), good.max()
        if greatest > 0:
            above = least if least > 0 else good.min(where=good > 0, initial=greatest)
            self.positive = min(self.positive, float(above))
        self.least, self.greatest = (
            min(self.least, float(least)),
            max(self.greatest, float(greatest)),
        )
        self.finite += good.size
        self.total += total

    @property
    def infinite(self) -> int:
        """Number of infinite values."""
        return self.size - self.finite - self.nan


def statistics(array: np.ndarray) -> ValueSummary:
    """Return range, mean, and numbers and first places of NaN and infinities of an array."""
    found = ValueSummary()
    for piece in _pieces(array):
        # A finite sum implies finite values, so most pieces need only one pass.
        total = _sum(piece)
        good = piece if np.isfinite(total) else _finite(found, piece)
        found.size += piece.size
        if good.size:
            found.add(good, total if good is piece else _sum(good))
    return found


def _sum(values: np.ndarray) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        return float(values.sum(dtype=np.float64))


def _finite(found: ValueSummary, piece: np.ndarray) -> np.ndarray:
    nan, finite = np.isnan(piece), np.isfinite(piece)
    found.nan += int(np.count_nonzero(nan))
    if found.first_nan is None and nan.any():
        found.first_nan = found.size + int(np.argmax(nan))
    infinite = ~(nan | finite)
    if found.first_infinite is None and infinite.any():
        found.first_infinite = found.size + int(np.argmax(infinite))
    return piece[finite]


def numbers(found: ValueSummary, shape: tuple[int, ...] | None = None) -> str:
    """Describe range, mean and non-finite values, with first indices in an array of `shape`.

    Examples
    --------
    >>> numbers(statistics(np.array([[1.0, 3.0], [np.nan, np.nan]])), (2, 2))
    '1 … 3, mean 2, 2 NaN (first at [1, 0])'
    """
    bad = [
        f"{count} {what}{_place(first, shape)}"
        for count, what, first in (
            (found.nan, "NaN", found.first_nan),
            (found.infinite, "infinite", found.first_infinite),
        )
        if count
    ]
    if not found.finite:
        return ", ".join(["no finite value", *bad])
    text = f"{found.least:.6g} … {found.greatest:.6g}, mean {found.total / found.finite:.6g}"
    return ", ".join([text, *(bad or ["all finite"])])


def _place(first: int | None, shape: tuple[int, ...] | None) -> str:
    if first is None or shape is None:
        return ""
    place = ", ".join(str(int(i)) for i in np.unravel_index(first, shape))
    return f" (first at [{place}])"


def histogram(array: np.ndarray, found: ValueSummary, logarithmic: bool) -> str:
    """Return a histogram between minimum and maximum as text bars; every non-empty bin is visible.

    A logarithmic histogram shows the positive values.
    """
    low, high = found.least, found.greatest
    if logarithmic:
        low, high = np.log10(found.positive), np.log10(high)
    counts = np.zeros(_WIDTH, dtype=np.int64)
    for piece in _pieces(array, stride(array.size)):
        good = piece[np.isfinite(piece)].astype(np.float64)
        values = np.log10(good[good > 0]) if logarithmic else good
        # Rounding must not push the end values out of the range.
        counts += np.histogram(np.clip(values, low, high), _WIDTH, (low, high))[0]
    heights = np.ceil(counts / max(1, counts.max()) * (len(_BARS) - 1)).astype(int)
    return f"|{''.join(_BARS[h] for h in heights)}|"


def stride(size: int) -> int:
    """Return the subsampling step of a histogram: one in `step` values is counted."""
    step = -(-size // _COUNTED)
    return step + (step > 1 and step % 2 == 0)  # odd, so that it does not align with an axis


def _pieces(array: np.ndarray, step: int = 1) -> Iterator[np.ndarray[Any, np.dtype[Any]]]:
    flat = array.reshape(-1)
    for start in range(0, flat.size, step * _PIECE):
        yield flat[start : start + step * _PIECE : step]
