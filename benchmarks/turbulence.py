"""Media in a field that changes from cell to cell, beside a surface whose crossings are counted.

    python benchmarks/turbulence.py --cells 96 --repeat 7

Random fields with the power spectrum of turbulence (k⁻⁴), the first of them as an exponential. All
pictures to the default tolerance, in turns; widths are in log10, where neighbouring cells differ by
about a tenth.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

import voluminous as vm
from timing import ratios, summary, table, take_turns

DENSE = "log10(a)"
COLORS = vm.ColorBy("b", "viridis", -2, 2)


def field(cells: int, rng: Any) -> np.ndarray:
    """Return a random field with mean zero and deviation one."""
    k = np.fft.fftfreq(cells) * cells
    square = k[:, None, None] ** 2 + k[None, :, None] ** 2 + k[None, None, :] ** 2
    waves = np.fft.fftn(rng.normal(size=(cells,) * 3)) / (1.0 + square)
    found = np.fft.ifftn(waves).real
    return ((found - found.mean()) / found.std()).astype(np.float32)


def shell(width: float, color: Any = (1.0,), **options: Any) -> vm.Gaussian:
    """Return a shell of some width."""
    return vm.Gaussian(DENSE, 0.3, width, color, 0.3, 0.1, **options)


def surface(color: Any = (1.0,), **options: Any) -> vm.Isosurface:
    """Return a surface."""
    return vm.Isosurface(DENSE, 0.3, color, 0.3, **options)


MEDIA = {
    "surface": surface(),
    "surface by gradient": surface(density="gradient"),
    "lit surface": surface(shading=1.0),
    "coloured surface": surface(COLORS),
    "shell, 0.003": shell(0.003),
    "shell, 0.03": shell(0.03),
    "shell, 0.1": shell(0.1),
    "shell, 0.3": shell(0.3),
    "two shells, 0.1": shell(0.1) + vm.Gaussian(DENSE, -0.3, 0.1, (0.1,), 0.3, 0.1),
    "coloured shell, 0.1": shell(0.1, COLORS),
    "soft gate, 0.1": shell(0.1, where="b"),
    "hard gate, 0.1": shell(0.1, where="b > 0"),
    "hard gate, colormap": vm.Colormap(DENSE, "viridis", -1, 1, 0.3, 0.3, where="b > 0"),
    "shell and surface": shell(0.1) + surface(),
    "coloured sheet, 0.1": surface(COLORS, width=0.1),
    "lit sheet, 0.1": surface(width=0.1, shading=1.0),
    "conditions": vm.Coefficients("where(log10(a) > 0.3, b*b, 0)", "where(b > 0.2, 1, 0)"),
    "slab, 0.1": vm.Rectangle(DENSE, 0.3, 0.1, (1.0,), 0.3, 0.1),
    "colormap": vm.Colormap(DENSE, "viridis", -1, 1, 0.3, 0.3),
    # With the length that is measured in the volume, once.
    "colormap, default length": vm.Colormap(DENSE, "viridis", -1, 1, 0.3),
}


def drawn(volume: vm.Volume, medium: Any, camera: Any) -> Callable[[], float]:
    """Return what draws a picture, and returns the seconds that took."""

    def draw() -> float:
        start = perf_counter()
        vm.render(volume, medium, camera, device="cpu")
        return perf_counter() - start

    return draw


def main() -> None:
    """Print the time of each medium, and its ratio to that of the surface."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", type=int, default=96)
    parser.add_argument("--pixels", type=int, default=300)
    parser.add_argument("--repeat", type=int, default=7)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    grid = vm.CartesianGrid.uniform(options.cells, (-1, 1))
    a, b = (field(options.cells, rng) for _ in range(2))
    volume = vm.Volume(grid, a=np.exp(a), b=b)
    camera = vm.Orthographic(37, 23, width=2.4, resolution=options.pixels)
    draws = {name: drawn(volume, medium, camera) for name, medium in MEDIA.items()}
    seconds = take_turns(draws, dict.fromkeys(draws, options.repeat))
    rows = []
    for name, own in seconds.items():
        time, ratio = summary(own), ratios(own, seconds["surface"])
        rows.append([name, f"{1e3 * time['median']:.0f}", f"{ratio['round']:.2f}"])
    print(table(["", "median ms", "over a surface"], rows))


if __name__ == "__main__":
    main()
