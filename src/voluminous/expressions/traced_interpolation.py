"""Enclosures of piecewise-linear tables inside kernels, by the rule of `interpolation`.

Between the ends of an interval lie any number of entries. Their extremes are those of two blocks of
2^k entries that may overlap, and extremes of all such blocks are tabulated: Bender & Farach-Colton,
*The LCA problem revisited* (2000), section 3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..backend import dr, from_host
from .drjit_ops import TablePosition, locate
from .traced_interval import TracedInterval, extremes
from .traced_rounding import float_info, larger, lowered, positive, raised, smaller

# In ε of the largest value around, as on the host.
_LOSS = 8.0


def interpolate_traced_ranges(
    x: TracedInterval, nodes: np.ndarray, columns: Sequence[np.ndarray]
) -> list[TracedInterval]:
    """Return enclosures of the columns interpolated anywhere in x: from both ends and all between.

    Parameters
    ----------
    x : TracedInterval
        Places.
    nodes : array, shape (n,)
        Increasing places of the entries, at least two.
    columns : sequence of array, shape (n,)
        The entries.
    """
    data = from_host(type(x.lo), nodes)
    first, last = (locate(end, data) for end in (x.lo, x.hi))
    return [_enclosure(column, first, last, x) for column in columns]


def slopes_in_ranges(x: TracedInterval, nodes: np.ndarray, values: np.ndarray) -> Any:
    """Return an enclosure of the slopes of a table in x, and where x is within one of its pieces.

    Parameters
    ----------
    x : TracedInterval
        Places.
    nodes, values : array, shape (n,)
        Increasing places of the entries, at least two, and the entries.

    Returns
    -------
    slope : TracedInterval
        Beyond the ends of the table it is zero.
    straight : Dr.Jit mask
        Whether there is no node between the ends of x.
    """
    real = type(x.lo)
    kept = nodes.astype(float_info(real).dtype).astype(np.float64)  # as the kernel has them
    rise, run = np.diff(values), np.diff(kept)
    steep = np.divide(rise, run, out=np.sign(rise) * np.inf, where=run > 0)
    slopes = np.concatenate([[0.0], steep, [0.0]])
    first, last = (locate(end, from_host(real, nodes)).passed for end in (x.lo, x.hi))
    lo, hi = (
        _extreme_between(slopes, extreme, first, last + 1, real(0))
        for extreme in (np.minimum, np.maximum)
    )
    return TracedInterval(lowered(lo), raised(hi), x.nan), first == last


def _enclosure(
    column: np.ndarray, first: TablePosition, last: TablePosition, x: TracedInterval
) -> Any:
    real = type(x.lo)
    data = from_host(real, column)
    pieces = [place.around(data) for place in (first, last)]
    values = [place.between(*own) for place, own in zip((first, last), pieces, strict=True)]
    # The entries between are among those around: with none between, any of the values will do.
    between = [
        _extreme_between(column, extreme, first.passed, last.passed, values[0])
        for extreme in (np.minimum, np.maximum)
    ]
    around = extremes([*pieces[0], *pieces[1], *between])
    return _moved_out(*extremes([*values, *between]), *around, x.nan)


def _moved_out(lo: Any, hi: Any, least: Any, most: Any, nan: Any) -> TracedInterval:
    """Return ends moved out by what rounding may lose; where all entries are equal, it is none."""
    info = float_info(type(lo))
    largest = larger(dr.abs(least), dr.abs(most))
    loss = dr.fma(largest, _LOSS * float(info.eps), float(info.tiny))
    loss = dr.select(least < most, loss, 0)
    lo, hi = lo - loss, hi + loss
    # Rounding never carries a value across zero.
    lo = dr.select(least >= 0, positive(lo), lo)
    hi = dr.select(most <= 0, -positive(-hi), hi)
    return TracedInterval(lo, hi, nan)


def _extreme_between(
    column: np.ndarray, extreme: Callable[..., Any], start: Any, stop: Any, otherwise: Any
) -> Any:
    """Return the extreme of ``column[start:stop]``; `otherwise` where that is empty."""
    real, UInt = type(otherwise), type(start)
    data = from_host(real, _extremes_of_blocks(column, extreme))
    some = start < stop
    level = 31 - dr.lzcnt(dr.select(some, stop - start, 1))
    row = level * dr.opaque(UInt, len(column))
    first = dr.gather(real, data, row + start, some)
    last = dr.gather(real, data, row + stop - (UInt(1) << level), some)
    found = smaller(first, last) if extreme is np.minimum else larger(first, last)
    return dr.select(some, found, otherwise)


def _extremes_of_blocks(column: np.ndarray, extreme: Callable[..., Any]) -> np.ndarray:
    """Return the extremes of 1, 2, 4 … entries from each entry on, one row after the other."""
    rows, half = [np.ascontiguousarray(column)], 1
    while 2 * half <= len(column):
        row = rows[-1].copy()
        row[:-half] = extreme(row[:-half], row[half:])
        rows.append(row)
        half *= 2
    return np.concatenate(rows)
