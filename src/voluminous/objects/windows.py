"""Pixels in rectangular windows, one window per thing: as flat lists."""

from __future__ import annotations

import numpy as np


def window_pixels(
    left: np.ndarray,
    right: np.ndarray,
    bottom: np.ndarray,
    top: np.ndarray,
    pixels: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which thing, x and y of all pixels that touch windows, shape (k,) each.

    Parameters
    ----------
    left, right, bottom, top : float arrays, shape (n,)
        Edges in pixels; the middle of the first pixel is at 0. Where one is NaN there is none.
    pixels : (int, int)
        Size of the picture: what is outside is left out.
    """
    nx, ny = pixels
    x0, columns = _range(left, right, nx)
    y0, rows = _range(bottom, top, ny)
    count = columns * rows
    owner = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(number, np.maximum(columns[owner], 1))
    return owner, x0[owner] + column, y0[owner] + row


def _range(low: np.ndarray, high: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    seen = np.isfinite(low) & np.isfinite(high)
    first, last = (
        np.clip(np.floor(np.where(seen, edge, 0.0) + 0.5), -1, count).astype(np.int64)
        for edge in (low, high)
    )
    first, last = np.maximum(first, 0), np.minimum(last, count - 1)
    return first, np.where(seen, np.maximum(last - first + 1, 0), 0)
