"""VTK's fixed-point ray caster and voluminous at equal error, in one process.

    python benchmarks/equal_error.py --scene core --repeat 9
    python benchmarks/equal_error.py --scene shell

Errors are rms differences from a converged picture (double precision, tolerance 1e-7), relative to
its maximum. VTK is run at several sample distances: finer ones make its fixed-point sums worse, so
its best is somewhere between. Scalars are interpolated linearly by both: log10(density) as a field
of its own in `core`, the distance from the centre in `shell`.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

import voluminous as vm
from our_scene import camera_of, medium_of, volume_of
from scenes import SCENES
from timing import summary, table, take_turns

DISTANCES = (2.0, 1.0, 0.5, 0.25)
TOLERANCES = (None, 1e-2, 1e-3)


class Ours:
    """One scene at one tolerance."""

    def __init__(self, scene: tuple[Any, Any, Any], tolerance: float | None) -> None:
        self.scene, self.tolerance = scene, tolerance

    def draw(self) -> float:
        """Draw; return the seconds."""
        start = perf_counter()
        self.image = vm.render(*self.scene, tolerance=self.tolerance, device="cpu")
        return perf_counter() - start

    def picture(self) -> np.ndarray:
        """Return the intensity."""
        return self.image.intensity


def core() -> tuple[tuple[Any, Any, Any], Callable[[float], Any]]:
    """Return the prestellar core with grey opacity, all in the picture, and how VTK sees it."""
    from vtk_scene import VtkScene

    scene = dataclasses.replace(SCENES["core_opaque"], frame=0.4)
    volume = volume_of(scene)
    volume["logn"] = "log10(density)"
    medium = sum(
        vm.Gaussian("logn", p.center, p.width, p.color, p.opacity, p.path_length)
        for p in medium_of(scene).components()
    )

    def theirs(distance: float) -> Any:
        drawn = VtkScene(scene, linear=True)
        drawn.mapper.SetSampleDistance(drawn._cell() * distance)
        return drawn

    return (volume, medium, camera_of(scene)), theirs


def shell() -> tuple[tuple[Any, Any, Any], Callable[[float], Any]]:
    """Return a thin shell in 512³ cells, 800 x 800 pixels."""
    from vtk_shell import VtkShell

    n, level, sigma, path, pixels = 512, 0.7, 0.004, 0.01, 800
    c = ((np.arange(n) + 0.5) / n * 2 - 1) ** 2
    radius = np.sqrt(c[:, None, None] + c[None, :, None] + c[None, None, :]).astype(np.float32)
    volume = vm.Volume(vm.CartesianGrid.uniform(n, (-1, 1)), radius=radius)
    medium = vm.Gaussian("radius", level, sigma, (0.3, 0.15, 0.06), 0.3, path)
    camera = vm.Orthographic(60, 30, width=2.2, resolution=pixels)

    def theirs(distance: float) -> Any:
        return VtkShell(radius, level, sigma, (1.0, 0.5, 0.2), 0.3, path, pixels, 2.2, distance)

    return (volume, medium, camera), theirs


def main() -> None:
    """Print times and errors of all contestants."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scene", choices=["core", "shell"], default="core")
    parser.add_argument("--repeat", type=int, default=7)
    options = parser.parse_args()
    ours, theirs = {"core": core, "shell": shell}[options.scene]()
    exact = vm.render(*ours, precision="double", tolerance=1e-7, cutoff=0).intensity
    contestants: dict[str, Any] = {f"ours, {t}": Ours(ours, t) for t in TOLERANCES}
    contestants |= {f"VTK, {d} cells": theirs(d) for d in DISTANCES}
    draws = {name: one.draw for name, one in contestants.items()}
    seconds = take_turns(draws, dict.fromkeys(draws, options.repeat))
    rows = []
    for name, one in contestants.items():
        off = (one.picture() - exact) / exact.max()
        told = summary(seconds[name])
        times = [f"{1e3 * told[k]:.1f}" for k in ("median", "min")]
        rows.append([name, *times, f"{np.sqrt(np.mean(off**2)):.1e}", f"{np.abs(off).max():.1e}"])
    print(table([options.scene, "median ms", "min ms", "rms error", "largest"], rows))


if __name__ == "__main__":
    main()
