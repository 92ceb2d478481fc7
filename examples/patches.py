"""Nested patches: a knot that the base grid cannot resolve, and patches of cells around it.

python examples/patches.py [pixels]

Blocks of cells along the knot are refined by 2, and blocks of those again by 3.
"""

from __future__ import annotations

import sys

import numpy as np

import voluminous as vm

BLOCK = 3  # cells per side that are refined together
WIDTH = 0.035  # of the string the knot is tied in


def knot(points: int = 600) -> np.ndarray:
    """Return points along a trefoil knot, shape (n, 3)."""
    t = np.linspace(0, 2 * np.pi, points)
    x, y = np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t)
    return 0.3 * np.stack([x, y, -1.2 * np.sin(3 * t)], axis=1)


def blocks(size: float) -> np.ndarray:
    """Return the numbers of the blocks of a size that hold the knot, or touch one that does."""
    found = np.unique(np.floor((knot() + 1.2) / size).astype(int), axis=0)
    near = np.array(np.meshgrid(*[[-1, 0, 1]] * 3)).reshape(3, -1).T
    touched = np.unique((found[:, None] + near).reshape(-1, 3), axis=0)
    return touched[((touched >= 0) & (touched < round(2.4 / size))).all(axis=1)]


def grid(levels: int, cells: int = 24) -> vm.PatchGrid:
    """Return 24³ cells, and patches on the first `levels` of two levels."""
    ratios, walls = (2, 3)[:levels], np.linspace(-1.2, 1.2, cells + 1)
    level, low, shape = [0], [[0, 0, 0]], [[cells] * 3]
    per_side = cells
    for k, ratio in enumerate(ratios, start=1):
        here = blocks(2.4 * BLOCK / per_side)
        level += [k] * len(here)
        low += (here * BLOCK * ratio).tolist()
        shape += [[BLOCK * ratio] * 3] * len(here)
        per_side *= ratio
    return vm.PatchGrid.from_boxes(walls, walls, walls, level, low, shape, ratios or 2)


def string(on: vm.PatchGrid) -> vm.Volume:
    """Return a density that falls with the distance from the knot."""
    centers, curve = on.cell_centers().T, knot()
    distance = np.full(on.size, np.inf)
    for point in curve:
        np.minimum(distance, ((centers - point) ** 2).sum(axis=1), out=distance)
    return vm.Volume(on, density=np.exp(-0.5 * distance / WIDTH**2))


def medium() -> vm.Medium:
    """Return the string, coloured by height, in its glow."""
    color = vm.ColorBy("z", "plasma", -0.45, 0.45, brightness=0.9)
    surface = vm.Isosurface("density", 0.3, color, opacity=1, shading=0.8)
    return surface + vm.Gaussian("density", 0.1, 0.03, (0.03, 0.04, 0.07), 0, WIDTH)


def main() -> None:
    """Save all pictures."""
    camera = vm.Orthographic(20, 30, width=2.2, resolution=int((*sys.argv[1:2], "400")[0]))
    for levels in range(3):
        image = vm.render(string(grid(levels)), medium(), camera, samples=2)
        image.save(f"patches_{levels}.png", exposure=1)
        print(f"patches_{levels}.png")


if __name__ == "__main__":
    main()
