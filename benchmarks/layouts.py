"""Cells of a Cartesian grid in memory row by row, beside blocks: what rays wait for.

    python benchmarks/layouts.py
    python benchmarks/layouts.py --cells 128 512

One packet of four numbers per cell, first order, nothing left out. All layouts compute the place of
a cell from its three indices, but for "rows", where it is counted along, as renders do.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

import voluminous as vm
from timing import summary, table, take_turns
from voluminous.backend import dr, from_host, get_backend
from voluminous.backend.functions import attenuation
from voluminous.schemes.base import Scheme, Solution

VIEWS = {"oblique": (60, 30), "another": (35, 70), "face-on": (90, 0)}


def rows(own: list[Any], n: int) -> Any:
    """Return the place of a cell in rows, z fastest."""
    i, j, k = own
    return (i * n + j) * n + k


def lines(own: list[Any], n: int) -> Any:
    """Return its place where 2 by 2 neighbours, along y and z, share a cache line."""
    i, j, k = own
    h = (n + 1) >> 1
    return ((i * h + (j >> 1)) * h + (k >> 1)) * 4 + (j & 1) * 2 + (k & 1)


def blocks(own: list[Any], n: int) -> Any:
    """Return its place in blocks of 4³ cells."""
    i, j, k = own
    h = (n + 3) >> 2
    block = ((i >> 2) * h + (j >> 2)) * h + (k >> 2)
    return block * 64 + (i & 3) * 16 + (j & 3) * 4 + (k & 3)


LAYOUTS: dict[str, Callable[[list[Any], int], Any]] = {
    "rows": rows,
    "2 x 2 in a line": lines,
    "blocks of 4^3": blocks,
}


class FirstOrder(Scheme):
    """First order with cells in a layout of their own."""

    name = "layout"

    def __init__(self, layout: str, n: int) -> None:
        self.layout, self.n, self.backend = layout, n, get_backend("cpu", "single")
        place = LAYOUTS[layout](list(np.indices((n, n, n))), n).ravel()
        values = np.zeros((int(place.max()) + 1, 4), np.float32)
        values[place] = np.float32([1.0, 0.5, 0.2, 0.1]) * (2.0 / n)
        self.values = from_host(self.backend.Float, values.ravel())

    def key(self) -> Any:
        """Return what identifies it: pictures launch the kernel of those before."""
        return ("layout", self.layout, self.n)

    def solve(self, segment: Any, source: Any, carried: list[Any]) -> tuple[Solution, list[Any]]:
        """Return the solution of one segment."""
        place = (
            segment.cell
            if self.layout == "rows"
            else self._place(segment.walk, segment.track, segment)
        )
        *j, alpha = dr.gather(self.backend.packet(4), self.values, place, segment.active)
        depth = alpha * segment.length
        theta, mean = attenuation(depth)
        seen = mean * segment.length
        return Solution([e * seen for e in j], [theta], [depth]), carried

    def _place(self, walk: Any, track: Any, segment: Any) -> Any:
        own = []
        for axis, index, stride in zip(
            walk.axes, segment.exit.index, track.cell_stride, strict=True
        ):
            mirrored = self.backend.Int(index)
            own.append(dr.select(stride < 0, axis.last_cell - mirrored, mirrored))
        return self.backend.UInt(LAYOUTS[self.layout](own, self.n))


def drawer(volume: vm.Volume, camera: Any, scheme: Any) -> Callable[[], float]:
    """Return a function that draws and returns the seconds."""
    medium = vm.Coefficients(["f", "f", "f"], "f")

    def draw() -> float:
        start = perf_counter()
        vm.render(volume, medium, camera, scheme=scheme, cutoff=0, device="cpu")
        return perf_counter() - start

    return draw


def main() -> None:
    """Print the times of all layouts over that of rows."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", type=int, nargs="+", default=[88, 128, 256, 400])
    parser.add_argument("--pixels", type=int, default=400)
    parser.add_argument("--repeat", type=int, default=9)
    options = parser.parse_args()
    found = []
    for n in options.cells:
        grid = vm.CartesianGrid.uniform(n, (-1, 1))
        volume = vm.Volume(grid, f=np.ones(grid.shape, np.float32))
        schemes = {layout: FirstOrder(layout, n) for layout in LAYOUTS}
        for view, angles in VIEWS.items():
            camera = vm.Orthographic(*angles, width=2.2, resolution=options.pixels)
            draws = {name: drawer(volume, camera, s) for name, s in schemes.items()}
            seconds = take_turns(draws, dict.fromkeys(draws, options.repeat))
            times = [summary(seconds[name])["median"] for name in draws]
            ratios = [f"{t / times[0]:.2f}" for t in times[1:]]
            found.append([f"{n}^3, {view}", f"{1e3 * times[0]:.1f}", *ratios])
    print(table(["cells, view", "rows, ms", *list(LAYOUTS)[1:]], found))


if __name__ == "__main__":
    main()
