"""Finite differences at the centres of the cells of a rectilinear grid.

All follow from parabolas through three neighbours, written with the slopes between them, so that a
constant has derivatives of exactly zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

Rule = Callable[[np.ndarray, np.ndarray], np.ndarray]


def differentiate(
    operation: str, values: np.ndarray, centers: Sequence[np.ndarray], keep: slice
) -> np.ndarray:
    """Return a derivative at cell centres.

    Parameters
    ----------
    operation : str
        ``gradmag`` |∇f|, ``laplacian`` ∇²f, or ``grad.x``, ``grad.y``, ``grad.z``.
    values : float64 array, shape (nx, ny, nz)
        f at the cell centres.
    centers : three arrays, shapes (nx,), (ny,), (nz,)
        The cell centres.
    keep : slice
        The layers of the first axis to return; the others serve as neighbours.
    """

    def along(axis: int, rule: Rule) -> np.ndarray:
        if axis == 0:
            return rule(values, centers[0])[keep]
        turned = rule(np.moveaxis(values[keep], axis, 0), centers[axis])
        return np.moveaxis(turned, 0, axis)

    if operation == "laplacian":
        return (
            along(0, second_derivative) + along(1, second_derivative) + along(2, second_derivative)
        )
    if operation == "gradmag":
        return np.sqrt(sum(along(axis, first_derivative) ** 2 for axis in range(3)))
    return along("xyz".index(operation[-1]), first_derivative)


def first_derivative(f: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return ∂f/∂x along the first axis: the slope of the parabola, at its middle or its ends.

    Two cells have one slope, for both; one cell has none: zero.
    """
    out = np.zeros_like(f)
    if len(x) < 3:
        out += np.diff(f, axis=0) / np.diff(x)[0] if len(x) == 2 else 0.0
        return out
    h, slope = _slopes(f, x)
    before, after = h[:-1] / (h[:-1] + h[1:]), h[1:] / (h[:-1] + h[1:])
    out[1:-1] = after * slope[:-1]
    out[1:-1] += before * slope[1:]
    out[0] = slope[0] - before[0] * (slope[1] - slope[0])
    out[-1] = slope[-1] + after[-1] * (slope[-1] - slope[-2])
    return out


def second_derivative(f: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return ∂²f/∂x² along the first axis: that of the parabola, which an end cell shares.

    One cell or two have none: zero.
    """
    out = np.zeros_like(f)
    if len(x) < 3:
        return out
    h, slope = _slopes(f, x)
    out[1:-1] = np.diff(slope, axis=0)
    out[1:-1] *= 2 / (h[:-1] + h[1:])
    out[0], out[-1] = out[1], out[-2]
    return out


def _slopes(f: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances of neighbours, with axes to multiply fields with, and the slopes."""
    h = np.diff(x)[:, None, None]
    slope = np.diff(f, axis=0)
    slope /= h
    return h, slope
