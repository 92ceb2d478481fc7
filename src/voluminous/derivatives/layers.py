"""A derivative of a whole volume, a few layers at a time, so that temporary arrays stay small."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..memory import check_memory

Rule = Callable[[str, np.ndarray, Sequence[np.ndarray], slice], np.ndarray]

# Layers that an end of the domain needs beside its own; elsewhere one would do.
_HALO = 2
# Cells differentiated at once.
_CHUNK = 1 << 21
# Numbers of float32 that are worth keeping as such: 19 digits below the largest are still normal.
_SMALLEST, _LARGEST = 1e-19, float(np.finfo(np.float32).max)


def whole(
    operation: str,
    layers: Callable[[slice], np.ndarray],
    centers: Sequence[np.ndarray],
    rule: Rule,
) -> np.ndarray:
    """Return a derivative on all cells.

    Parameters
    ----------
    operation : str
        See `differentiate`.
    layers : callable
        Returns what is differentiated, for layers of the first axis.
    centers : three arrays
        The cell centres along each axis.
    rule : callable
        The differences, called as `differences.differentiate`.

    Returns
    -------
    array
        float32 if that is what is differentiated, and if the result is neither too small nor too
        large for it (as of 1e-20 g/cm³ over a parsec in cm), else float64.
    """
    if layers(slice(0, 1)).dtype == np.float32:
        found, largest = _filled(np.dtype(np.float32), operation, layers, centers, rule)
        if _fits_single(largest):
            return found
        del found
    return _filled(np.dtype(np.float64), operation, layers, centers, rule)[0]


def _filled(
    dtype: np.dtype,
    operation: str,
    layers: Callable[[slice], np.ndarray],
    centers: Sequence[np.ndarray],
    rule: Rule,
) -> tuple[np.ndarray, float]:
    shape = tuple(len(c) for c in centers)
    nx, ny, nz = shape
    check_memory(
        nx * ny * nz * dtype.itemsize,
        f"{operation} of a field of {nx} x {ny} x {nz} cells",
        "crop or coarsen the volume",
    )
    out, largest = np.empty(shape, dtype), 0.0
    step = max(1, _CHUNK // (ny * nz))
    for first in range(0, nx, step):
        last = min(first + step, nx)
        part = _part(operation, layers, centers, (first, last), rule)
        largest = max(largest, _largest(part))
        out[first:last] = part
    return out, largest


def _part(
    operation: str,
    layers: Callable[[slice], np.ndarray],
    centers: Sequence[np.ndarray],
    kept: tuple[int, int],
    rule: Rule,
) -> np.ndarray:
    first, last = kept
    low, high = max(0, first - _HALO), min(last + _HALO, len(centers[0]))
    # Differences lose digits, and squares of cgs units leave the range of float32.
    values = layers(slice(low, high)).astype(np.float64)
    near = (centers[0][low:high], *centers[1:])
    return rule(operation, values, near, slice(first - low, last - low))


def in_single(values: np.ndarray) -> bool:
    """Return True if float32 is enough for values, neither too small nor too large."""
    return _fits_single(_largest(values))


def _fits_single(largest: float) -> bool:
    return largest == 0 or _SMALLEST <= largest <= _LARGEST


def _largest(values: np.ndarray) -> float:
    size = np.abs(values)
    return float(np.max(size, where=np.isfinite(size), initial=0.0))
