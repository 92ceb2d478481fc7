"""What 10 000 stars add to a picture: points, points with a PSF, and discs, in each scheme.

    python benchmarks/stars.py
    python benchmarks/stars.py --cells 128 --stars 1000 --rounds 3

The picture is 1.1 times as wide as the cube, through which stars are spread evenly. Seconds are
those of the process on all its threads: they depend less on who else computes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import voluminous as vm
from timing import ratios, table, take_turns

WIDTH = 2.2
SCHEMES: dict[str, dict[str, Any]] = {
    "first order": {"scheme": "first-order"},
    "second order": {"scheme": "second-order"},
    "post-classified, None": {"tolerance": None},
    "post-classified, 1e-3": {},
}
MEDIUM = vm.Coefficients(["dust", "dust", "2 * dust"], "dust")


def cloud(cells: int) -> vm.Volume:
    """Return dust in a cube from -1 to 1: dense in the middle, nowhere empty."""
    x = np.linspace(-1, 1, cells, dtype=np.float32)
    square = x[:, None, None] ** 2 + x[:, None] ** 2 + 2 * x**2
    grid = vm.CartesianGrid.uniform(cells, (-1, 1))
    return vm.Volume(grid, dust=np.float32(0.05) + np.exp(-square / np.float32(0.3)))


def clusters(count: int, pixel: float) -> dict[str, list[vm.Stars]]:
    """Return the same stars in several forms; "none" is the picture without them."""
    rng = np.random.default_rng(1)
    places, light = rng.uniform(-1, 1, (count, 3)), 10 ** rng.normal(-4, 0.5, count)
    color = (1, 0.8, 0.6)
    return {
        "none": [],
        "points": [vm.Stars(places, color, luminosities=light)],
        "PSF of 2 pixels": [vm.Stars(places, color, luminosities=light, psf=2.0)],
        "PSF of 4 pixels": [vm.Stars(places, color, luminosities=light, psf=4.0)],
        "discs, radius 1 pixel": [vm.Stars(places, color, radii=pixel)],
        "discs, radius 2 pixels": [vm.Stars(places, color, radii=2 * pixel)],
    }


def drawing(
    volume: vm.Volume, camera: vm.Orthographic, objects: list[vm.Stars], options: dict[str, Any]
) -> Callable[[], float]:
    """Return what draws once and tells the seconds of all threads."""

    def draw() -> float:
        start = time.process_time()
        vm.render(volume, MEDIUM, camera, objects=objects, device="cpu", **options)
        return time.process_time() - start

    return draw


def main() -> None:
    """Print, for each scheme, times and the ratio to the picture without stars."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    for name, default in (("cells", 256), ("pixels", 800), ("stars", 10_000), ("rounds", 7)):
        parser.add_argument(f"--{name}", type=int, default=default)
    args = parser.parse_args()
    volume = cloud(args.cells)
    camera = vm.Orthographic(65, 30, width=WIDTH, resolution=args.pixels)
    forms = clusters(args.stars, WIDTH / args.pixels)
    for scheme, options in SCHEMES.items():
        draws = {form: drawing(volume, camera, stars, options) for form, stars in forms.items()}
        seconds = take_turns(draws, dict.fromkeys(draws, args.rounds))
        rows = []
        for form, times in seconds.items():
            found = ratios(times, seconds["none"])
            rows.append(
                [form, f"{min(times) * 1e3:.0f} ms", f"{found['min']:.2f}", f"{found['round']:.2f}"]
            )
        print(table([scheme, "best", "of minima", "of rounds"], rows), end="\n\n", flush=True)


if __name__ == "__main__":
    main()
