"""Does a name list nx, ny, nz or nz, ny, nx? In the right order neighbouring values are alike."""

from __future__ import annotations

import numpy as np

# Runs of neighbours that are compared: few, since each is looked up in the file.
_RUNS, _RUN = 64, 4096
# So much less must the difference be in the opposite order, lest noise decide.
_CLEARLY = 0.97


def is_turned(values: np.ndarray, shape: tuple[int, int, int]) -> tuple[bool, str]:
    """Return whether a shape is meant in the opposite order, and why.

    Parameters
    ----------
    values : array, shape (n,)
        The numbers as they are in the file (or many of the first), x fastest.
    shape : tuple of three int
        As the name lists it.

    Returns
    -------
    bool
        True if neighbours along y and z differ clearly less where the last number is taken for x.
    str
        What was found, in words.
    """
    plain = _roughness(values, shape)
    turned = _roughness(values, shape[::-1])
    decided = turned < _CLEARLY * plain
    order = "nz x ny x nx" if decided else "nx x ny x nz"
    return decided, (
        f"read as {order}: neighbouring values differ by {min(plain, turned):.3g} on average"
        f"{f', else by {max(plain, turned):.3g}' if decided or plain < turned else ' either way'}"
    )


def _roughness(values: np.ndarray, shape: tuple[int, int, int]) -> float:
    """Return the mean difference of neighbours along y and z; infinite if none is known."""
    nx, ny, _ = shape
    found = [_difference(values, step) for step in (nx, nx * ny)]
    known = [value for value in found if np.isfinite(value)]
    return float(np.mean(known)) if known else float("inf")


def _difference(values: np.ndarray, step: int) -> float:
    count = len(values) - step
    if count < 1:
        return float("nan")
    starts = np.unique(np.linspace(0, max(count - _RUN, 0), _RUNS).astype(np.int64))
    first = (starts[:, None] + np.arange(min(_RUN, count))).reshape(-1)
    # Double precision holds the difference of any two values.
    pair = values[first].astype(np.float64), values[first + step].astype(np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        change = np.abs(pair[1] - pair[0])
    change = change[np.isfinite(change)]
    return float(change.mean()) if len(change) else float("nan")
