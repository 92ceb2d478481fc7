"""Values at the corners of cells, and between them."""

from __future__ import annotations

import itertools

import numpy as np


def vertex_means(cells: np.ndarray) -> np.ndarray:
    """Average cell values (nx, ny, nz, C) to vertices (nx+1, ny+1, nz+1, C).

    A vertex gets the plain mean of the cells around it that exist: 8 inside, 1 at a corner.
    """
    shape = tuple(n + 1 for n in cells.shape[:3])
    total = np.zeros((*shape, cells.shape[3]))
    count = np.zeros((*shape, 1))
    for corner in itertools.product((0, 1), repeat=3):
        around = tuple(slice(c, c + n) for c, n in zip(corner, cells.shape, strict=False))
        total[around] += cells
        count[around] += 1
    return total / count


def interpolate(edges, vertices: np.ndarray, cell, points: np.ndarray) -> np.ndarray:
    """Interpolate trilinearly in given cells (on a wall: bilinearly in that face).

    ``vertices`` has shape (nx+1, ny+1, nz+1, C), ``points`` (N, 3); returns (N, C).
    """
    weights = [_weights(edges[axis], cell[axis], points[:, axis]) for axis in range(3)]
    value = np.zeros((len(points), vertices.shape[3]))
    for corner in itertools.product((0, 1), repeat=3):
        weight = weights[0][corner[0]] * weights[1][corner[1]] * weights[2][corner[2]]
        at = tuple(i + c for i, c in zip(cell, corner, strict=True))
        value += weight[:, None] * vertices[at]
    return value


def _weights(walls: np.ndarray, index: np.ndarray, x: np.ndarray):
    low, high = walls[index], walls[index + 1]
    upper = np.clip((x - low) / (high - low), 0.0, 1.0)
    return 1 - upper, upper
