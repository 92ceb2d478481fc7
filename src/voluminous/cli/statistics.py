"""Ranges and histograms of arrays, in pieces: temporary arrays stay small."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

_PIECE = 1 << 20
_BARS = " ▁▂▃▄▅▆▇█"
_WIDTH = 48


@dataclass
class Statistics:
    """What there is in an array: numbers of values, and the range of the finite ones."""

    size: int = 0
    finite: int = 0
    nan: int = 0
    least: float = np.inf
    greatest: float = -np.inf
    total: float = 0.0

    @property
    def infinite(self) -> int:
        """Number of infinite values."""
        return self.size - self.finite - self.nan


def statistics(array: np.ndarray) -> Statistics:
    """Return range, mean and number of NaN of an array."""
    found = Statistics()
    for piece in _pieces(array):
        good = piece[np.isfinite(piece)]
        found.size += piece.size
        found.finite += good.size
        found.nan += int(np.isnan(piece).sum())
        if good.size:
            found.least = min(found.least, float(good.min()))
            found.greatest = max(found.greatest, float(good.max()))
            found.total += float(good.sum())
    return found


def numbers(found: Statistics) -> str:
    """Return range, mean and what is not finite in words."""
    if not found.finite:
        return f"no finite value, {found.nan} NaN, {found.infinite} infinite"
    text = f"{found.least:.6g} … {found.greatest:.6g}, mean {found.total / found.finite:.6g}"
    bad = [f"{n} {what}" for n, what in ((found.nan, "NaN"), (found.infinite, "infinite")) if n]
    return ", ".join([text, *bad]) if bad else f"{text}, all finite"


def histogram(array: np.ndarray, found: Statistics, logarithmic: bool) -> str:
    """Return bars that show how often values between least and greatest occur; any is visible."""
    low, high = found.least, found.greatest
    if logarithmic:
        low, high = np.log10(low), np.log10(high)
    counts = np.zeros(_WIDTH, dtype=np.int64)
    for piece in _pieces(array):
        good = piece[np.isfinite(piece)]
        values = np.log10(good) if logarithmic else good
        # Rounding must not push the ends out of the range.
        counts += np.histogram(np.clip(values, low, high), _WIDTH, (low, high))[0]
    heights = np.ceil(counts / max(1, counts.max()) * (len(_BARS) - 1)).astype(int)
    return f"|{''.join(_BARS[h] for h in heights)}|"


def _pieces(array: np.ndarray) -> Iterator[np.ndarray[Any, np.dtype[np.float64]]]:
    flat = array.reshape(-1)
    for start in range(0, flat.size, _PIECE):
        yield flat[start : start + _PIECE].astype(np.float64)
