"""What a tolerance costs, what it buys, and whether the error that is told holds.

    python benchmarks/tolerance.py                    # all scenes
    python benchmarks/tolerance.py --scene dust --pixels 200

For each scene and tolerance: the median time and its ratio to that of ``"pre-integrated"``; the rms
and the largest true error as parts of the maximum, against a picture in double precision to 1e-8;
the largest true error over the tolerance; and the share of pixels within ``image.error``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import voluminous as vm
from our_scene import OurScene
from scenes import SCENES
from timing import table
from turbulence import field

TOLERANCES = (None, 1e-2, 1e-3, 1e-4, 1e-6)
Made = tuple[vm.Volume, vm.Medium, vm.Orthographic]


def turbulent(cells: int = 96) -> vm.Volume:
    """Return two turbulent fields."""
    rng = np.random.default_rng(0)
    a, b = (field(cells, rng) for _ in range(2))
    return vm.Volume(vm.CartesianGrid.uniform(cells, (-1, 1)), a=np.exp(a), b=b)


def seen(pixels: int) -> vm.Orthographic:
    return vm.Orthographic(37, 23, width=2.4, resolution=pixels)


def core(pixels: int) -> Made:
    """The note's first figure: two shells in a smooth core."""
    scene = OurScene(SCENES["core"], "post-classified", pixels=pixels)
    return scene.volume, scene.medium, scene.camera


def sparse(pixels: int) -> Made:
    """One thin shell in 128³ cells: rays meet it twice."""
    volume = vm.Volume(vm.CartesianGrid.uniform(128, (-1, 1)))
    volume["radius"] = "sqrt(x**2 + y**2 + z**2)"
    return volume, vm.Gaussian("radius", 0.6, 0.01, (1.0, 0.6, 0.2), 0.5, 0.05), seen(pixels)


def turbulence(pixels: int) -> Made:
    """Two shells in turbulence."""
    shells = vm.Gaussian("log10(a)", 0.3, 0.1, (1.0, 0.6, 0.2), 0.3, 0.1)
    shells += vm.Gaussian("log10(a)", -0.3, 0.1, (0.2, 0.5, 1.0), 0.3, 0.1)
    return turbulent(), shells, seen(pixels)


def dust(pixels: int) -> Made:
    """Three channels of dust, with an extinction each (optical depth 13), in smooth fields."""
    volume = vm.Volume(vm.CartesianGrid.uniform(64, (-1, 1)))
    volume["rho"] = "exp(-3 * (x**2 + y**2 + 2 * z**2))"
    volume["t"] = "0.3 + 0.7 * exp(-2 * (x**2 + y**2 + z**2))"
    kappa, places = (12.0, 5.0, 2.0), (2.0, 1.0, 0.5)
    j = [f"rho*{k}*{p**3}/(exp({p}/t)-1)" for k, p in zip(kappa, places, strict=True)]
    return volume, vm.Coefficients(j, [f"rho*{k}" for k in kappa]), seen(pixels)


def ten(pixels: int) -> Made:
    """A table of ten entries in turbulence."""
    rng = np.random.default_rng(1)
    values = np.linspace(-1.2, 1.2, 10)
    colors, opacities = rng.random((10, 3)), 0.3 * rng.random(10) * (rng.random(10) < 0.7)
    return turbulent(), vm.Table("log10(a)", values, colors, opacities, 0.1), seen(pixels)


def colored(pixels: int) -> Made:
    """A shell coloured by another field."""
    color = vm.ColorBy("b", "viridis", -2, 2)
    return turbulent(), vm.Gaussian("log10(a)", 0.3, 0.1, color, 0.3, 0.1), seen(pixels)


def gated(pixels: int) -> Made:
    """A shell behind a condition."""
    shell = vm.Gaussian("log10(a)", 0.3, 0.1, (1.0, 0.6, 0.2), 0.3, 0.1, where="b > 0")
    return turbulent(), shell, seen(pixels)


def surfaces(pixels: int) -> Made:
    """Three surfaces without width."""
    return turbulent(), vm.Isosurface("log10(a)", [-0.4, 0.0, 0.4], "viridis", 0.3), seen(pixels)


SCENES_HERE: dict[str, Callable[[int], Made]] = {
    "core": core,
    "sparse": sparse,
    "turbulence": turbulence,
    "dust": dust,
    "ten": ten,
    "colored": colored,
    "gated": gated,
    "surfaces": surfaces,
}


def measured(made: Made, tolerance: float | None, repeat: int) -> tuple[float, vm.Image]:
    """Return the median time of a picture after the first, and the picture."""
    options: dict[str, Any] = {"tolerance": tolerance, "device": "cpu", "progress": False}
    image = vm.render(*made, **options)
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        image = vm.render(*made, **options)
        times.append(time.perf_counter() - start)
    return float(np.median(times)), image


def main() -> None:
    """Print the table of each scene."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scene", choices=SCENES_HERE, action="append")
    parser.add_argument("--pixels", type=int, default=400)
    parser.add_argument("--repeat", type=int, default=5)
    options = parser.parse_args()
    for name in options.scene or SCENES_HERE:
        made = SCENES_HERE[name](options.pixels)
        exact = vm.render(*made, tolerance=1e-8, precision="double", progress=False).intensity
        top, rows, base = float(exact.max()), [], 0.0
        for tolerance in TOLERANCES:
            seconds, image = measured(made, tolerance, options.repeat)
            base = base or seconds
            off = np.abs(image.intensity - exact).max(axis=-1) / top
            told = None if image.error is None else image.error / top
            worst = 0.0 if tolerance is None else float(np.quantile(off, 0.999)) / tolerance
            rows.append(
                [
                    str(tolerance),
                    f"{1e3 * seconds:.0f}",
                    f"{seconds / base:.2f}",
                    f"{np.sqrt(np.mean(off**2)):.1e}",
                    f"{off.max():.1e}",
                    f"{worst:.3f}",
                    "" if told is None else f"{told.max():.1e}",
                    "" if told is None else f"{100 * np.mean(off <= told + 1e-9):.2f}",
                ]
            )
        heads = ["tolerance", "ms", "ratio", "rms", "largest", "/tolerance", "told", "honest %"]
        print(f"\n{name}: {SCENES_HERE[name].__doc__}\n{table(heads, rows)}", flush=True)


if __name__ == "__main__":
    main()
