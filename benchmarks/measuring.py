"""Time of columns: exactly and by rays, and beside yt's off-axis projection.

    python benchmarks/measuring.py
    python benchmarks/measuring.py --small

yt is left out where it is not installed. Totals are compared too: nothing may be lost.
"""

from __future__ import annotations

import argparse
import importlib.util
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import voluminous as vm
from timing import table

ROUNDS = 5


def cube(cells: int) -> vm.Volume:
    """Return random numbers on equal cells from -1 to 1."""
    grid = vm.CartesianGrid.uniform(cells, (-1, 1))
    return vm.Volume(grid, a=np.random.default_rng(0).random(grid.shape, dtype=np.float32))


def octree(base: int) -> vm.Volume:
    """Return random numbers on an octree that is refined five times towards its middle."""
    walls = np.linspace(-1, 1, base + 1)

    def near(x: Any, y: Any, z: Any, size: Any) -> Any:
        return np.sqrt(x * x + y * y + z * z) < 0.7 * base * size

    grid = vm.OctreeGrid.from_function(walls, walls, walls, near, 5)
    return vm.Volume(grid, a=np.random.default_rng(0).random(grid.size))


def camera(turn: int, pixels: int) -> vm.Orthographic:
    """Return a view that has not been taken before."""
    return vm.Orthographic(50 + turn, 30, resolution=pixels)


def timed(draw: Callable[[int], float]) -> tuple[float, float]:
    """Return the best time of some rounds, after one that compiles, and the total found."""
    found = [(0.0, draw(0))]
    for turn in range(1, ROUNDS + 1):
        start = time.perf_counter()
        total = draw(turn)
        found.append((time.perf_counter() - start, total))
    return min(found[1:])


def ours(volume: vm.Volume, method: str, pixels: int) -> Callable[[int], float]:
    """Return what makes a map of a column, and adds it up."""

    def draw(turn: int) -> float:
        image = vm.column(volume, "a", camera(turn, pixels), method=method)
        return float(image.intensity.sum() * np.prod(image.pixel_size))

    return draw


def with_yt(volume: vm.Volume, pixels: int) -> Callable[[int], float]:
    """Return what makes yt's off-axis projection of the same cells."""
    import yt

    yt.set_log_level(50)
    shape, box = volume.grid.shape, volume.grid.bounds
    data = {"a": (volume.array("a").astype(float), "dimensionless")}
    ds = yt.load_uniform_grid(data, shape, length_unit="cm", bbox=box)

    def draw(turn: int) -> float:
        frame = camera(turn, pixels).frame(volume.grid)
        away = frame.vectors[3]
        width = ds.arr([*frame.width, 4.0], "cm")
        image = yt.off_axis_projection(
            ds, [0, 0, 0], away, width, pixels, ("stream", "a"), north_vector=frame.vectors[2]
        )
        return float(np.sum(image) * np.prod(frame.pixel))

    return draw


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--small", action="store_true", help="an eighth of the cells")
    args = parser.parse_args()
    part = 2 if args.small else 1
    small, large, tree = cube(128 // part), cube(256 // part), octree(32 // part)
    cases = [
        (f"{128 // part}³, exact", small, ours(small, "exact", 512)),
        (f"{128 // part}³, rays", small, ours(small, "rays", 512)),
        (f"{256 // part}³, rays", large, ours(large, "rays", 512)),
        (f"octree of {tree.grid.size}, exact", tree, ours(tree, "exact", 512)),
    ]
    if importlib.util.find_spec("yt"):
        cases.append((f"{128 // part}³, yt off-axis", small, with_yt(small, 512)))
    rows = []
    for name, volume, draw in cases:
        seconds, total = timed(draw)
        inside = float((volume.array("a").astype(float) * volume.grid.cell_volumes).sum())
        rows.append([name, f"{seconds:.3f} s", f"{total / inside - 1:.1e}"])
    print(table(["onto 512² pixels", "best", "total, off by"], rows))


if __name__ == "__main__":
    main()
