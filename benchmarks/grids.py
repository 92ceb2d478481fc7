"""What a ray and a cell it visits cost on every grid, beside a Cartesian one of as many cells.

    python benchmarks/grids.py
    python benchmarks/grids.py --large      # also 38 million leaves; needs 6 GB

Each grid is seen by 400 x 400 rays. Visited cells are counted by a scheme that does nothing else.
"""

from __future__ import annotations

import argparse
from time import perf_counter
from typing import Any

import numpy as np

import voluminous as vm
from timing import summary, table, take_turns
from voluminous.backend import dr
from voluminous.schemes.base import Scheme
from voluminous.schemes.path import Path

CAMERA = vm.Orthographic(60, 30, width=2.2, resolution=400, center=(0, 0, 0))
# Four numbers per cell, seen everywhere: nothing is leapt over.
MEDIUM = vm.Coefficients(["f", "0.5*f", "0.2*f"], "0.1*f")
SCHEMES = {
    "first": {"scheme": "first-order", "cutoff": 0},
    "second": {"scheme": "second-order", "cutoff": 0},
    "post, None": {"tolerance": None, "cutoff": 0},
    "post, 1e-3": {"tolerance": 1e-3, "cutoff": 0},
}


class Steps(Scheme):
    """Counts the cells that rays visit, as light and as optical depth."""

    name = "steps"

    def solve(self, segment: Any, source: Any, carried: list[Any]) -> tuple[Path, list[Any]]:
        """Return one for every segment."""
        channels, real = source.channels, type(segment.length)
        one = dr.select(segment.active & (segment.length > 0), real(1), 0)
        return Path(
            [one for _ in range(channels.emissions)],
            [real(1) for _ in range(channels.extinctions)],
            [one for _ in range(channels.extinctions)],
        ), carried


def shells(width: float) -> Any:
    """Return a rule that refines around two spheres, so many cells on either side."""

    def refine(x: Any, y: Any, z: Any, size: Any) -> Any:
        r = np.sqrt(x * x + y * y + z * z)
        return (abs(r - 0.6) < width * size) | (abs(r - 0.3) < width * size)

    return refine


def grids(large: bool) -> dict[str, Any]:
    """Return grids that fill about the same ball or box."""
    base = [np.linspace(-1, 1, 33)] * 3
    tree = vm.OctreeGrid.from_function(*base, shells(1.5), 3)
    tiles = np.stack(np.meshgrid(*[np.arange(11)] * 3, indexing="ij"), -1).reshape(-1, 3)
    lower = -1 + tiles * (2 / 11)
    made = {
        "Cartesian 88^3": vm.CartesianGrid.uniform(88, (-1, 1)),
        "octree": tree,
        "patches, 8^3 cells": vm.PatchGrid(lower, lower + 2 / 11, [[8, 8, 8]] * len(tiles)),
        "spherical": vm.SphericalGrid(
            np.linspace(0, 1, 101), np.linspace(0, np.pi, 65), np.linspace(0, 2 * np.pi, 129)
        ),
        "cylindrical": vm.CylindricalGrid(
            np.linspace(0, 1, 101), np.linspace(0, 2 * np.pi, 129), np.linspace(-1, 1, 65)
        ),
    }
    if large:
        made["Cartesian 336^3"] = vm.CartesianGrid.uniform(336, (-1, 1))
        made["octree, large"] = vm.OctreeGrid.from_function(*base, shells(9.0), 4)
    return made


def volume_of(grid: Any) -> vm.Volume:
    """Return a smooth field on a grid."""
    values = np.empty(grid.size, np.float32)
    for first in range(0, grid.size, 1 << 20):
        last = min(first + (1 << 20), grid.size)
        x, y, z = grid.cell_centers(first, last)
        values[first:last] = np.exp(-(x * x + y * y + z * z))
    return vm.Volume(grid, f=values.reshape(grid.shape))


def drawer(volume: vm.Volume, options: dict[str, Any]) -> Any:
    """Return a function that draws and returns the seconds."""

    def draw() -> float:
        start = perf_counter()
        vm.render(volume, MEDIUM, CAMERA, device="cpu", **options)
        return perf_counter() - start

    return draw


def main() -> None:
    """Print nanoseconds per ray and visited cell."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--repeat", type=int, default=5)
    options = parser.parse_args()
    rows = []
    for name, grid in grids(options.large).items():
        volume = volume_of(grid)
        steps = vm.render(volume, MEDIUM, CAMERA, scheme=Steps(), cutoff=0).optical_depth[..., 0]
        chosen = {"first": SCHEMES["first"]} if grid.size > 1e7 else SCHEMES
        draws = {scheme: drawer(volume, kw) for scheme, kw in chosen.items()}
        seconds = take_turns(draws, dict.fromkeys(draws, options.repeat))
        told = [1e9 * summary(seconds[s])["median"] / steps.sum() for s in chosen]
        rows.append([name, f"{grid.size / 1e6:.2f}", f"{steps.sum() / 1e6:.1f}"])
        rows[-1] += [f"{t:.2f}" for t in told] + [""] * (len(SCHEMES) - len(told))
    print(table(["grid", "10^6 cells", "10^6 visits", *SCHEMES], rows))


if __name__ == "__main__":
    main()
