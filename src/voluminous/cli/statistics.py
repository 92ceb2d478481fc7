"""Ranges and histograms of arrays, computed in pieces so that temporary arrays stay small."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

_PIECE = 1 << 20
_BARS = " ▁▂▃▄▅▆▇█"
_WIDTH = 48
# Maximum number of values in a histogram; larger arrays are subsampled (the range is exact).
_COUNTED = 1 << 24
# A histogram is logarithmic if maximum / smallest positive value exceeds this.
_WIDE = 1e2
_BAD = {"NaN": np.isnan, "infinite": np.isinf}


@dataclass
class ValueSummary:
    """Statistics of an array: numbers of values, and the range of the finite values.

    `positive` is the smallest positive value; `bad` has the number of "NaN" and of "infinite"
    values, and the flat index of the first, where there are any.
    """

    size: int = 0
    finite: int = 0
    least: float = np.inf
    greatest: float = -np.inf
    positive: float = np.inf
    total: float = 0.0
    bad: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def varies(self) -> bool:
        """True if there are two different finite values or more."""
        return self.least < self.greatest


def statistics(array: np.ndarray) -> ValueSummary:
    """Return range, mean, and numbers and first places of NaN and infinities of an array."""
    found = ValueSummary()
    for piece in _pieces(array):
        good = piece[np.isfinite(piece)]
        if good.size < piece.size:
            for name, test in _BAD.items():
                places = np.flatnonzero(test(piece))
                if places.size:
                    count, first = found.bad.get(name, (0, found.size + int(places[0])))
                    found.bad[name] = count + places.size, first
        found.size += piece.size
        if good.size:
            found.finite += good.size
            found.least = min(found.least, float(good.min()))
            found.greatest = max(found.greatest, float(good.max()))
            if (above := good[good > 0]).size:
                found.positive = min(found.positive, float(above.min()))
            found.total += float(good.sum(dtype=np.float64))
    return found


def numbers(found: ValueSummary, shape: tuple[int, ...] | None = None) -> str:
    """Describe range, mean and non-finite values, with first indices in an array of `shape`.

    Examples
    --------
    >>> numbers(statistics(np.array([[1.0, 3.0], [np.nan, np.nan]])), (2, 2))
    '1 … 3, mean 2, 2 NaN (first at [1, 0])'
    """
    bad = []
    for name, (count, first) in sorted(found.bad.items()):
        place = "" if shape is None else [int(i) for i in np.unravel_index(first, shape)]
        bad.append(f"{count} {name}" + (f" (first at {place})" if place else ""))
    if not found.finite:
        return ", ".join(["no finite value", *bad])
    text = f"{found.least:.6g} … {found.greatest:.6g}, mean {found.total / found.finite:.6g}"
    return ", ".join([text, *(bad or ["all finite"])])


def histogram(array: np.ndarray, found: ValueSummary) -> str:
    """Return a histogram between minimum and maximum as text bars, and its scale.

    Every non-empty bin is visible. A logarithmic histogram shows the positive values.
    """
    step = -(-found.size // _COUNTED)
    step += step > 1 and step % 2 == 0  # odd, so that it does not align with an axis
    wide = found.greatest > _WIDE * found.positive
    logarithmic = array.dtype.kind == "f" and found.least >= 0 and wide
    low, high = found.least, found.greatest
    if logarithmic:
        low, high = np.log10(found.positive), np.log10(high)
    counts = np.zeros(_WIDTH, dtype=np.int64)
    for piece in _pieces(array, step):
        good = piece[np.isfinite(piece)].astype(np.float64)
        values = np.log10(good[good > 0]) if logarithmic else good
        # Rounding must not push the end values out of the range.
        counts += np.histogram(np.clip(values, low, high), _WIDTH, (low, high))[0]
    heights = np.ceil(counts / max(1, counts.max()) * (len(_BARS) - 1)).astype(int)
    scale = "logarithmic" if logarithmic else "linear"
    scale += ", of those above zero" * (logarithmic and not found.least)
    scale += f", of one value in {step}" * (step > 1)
    return f"|{''.join(_BARS[h] for h in heights)}|  {scale}"


def _pieces(array: np.ndarray, step: int = 1) -> Iterator[np.ndarray]:
    flat = array.reshape(-1)
    for start in range(0, flat.size, step * _PIECE):
        yield flat[start : start + step * _PIECE : step]
