"""Show that the cost grows in proportion to rays x cells crossed, from 64^3 to 512^3 cells.

    python benchmarks/scaling.py --cells 64 128 256 512

The steps are counted here, from the geometry alone: a ray that crosses k cell walls inside the box
has been in k + 1 cells.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scenes import PIXELS, SCENES, Scene
from timing import summary, table, take_turns

SCHEMES = ("first-order", "second-order")


def ray_points(scene: Scene, pixels: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixel centres (rays, 3) on the plane through the origin, and the direction, pc."""
    towards, up = scene.view()
    right = np.cross(up, towards)
    offsets = (np.arange(pixels) - (pixels - 1) / 2) * scene.frame / pixels
    points = offsets[:, None, None] * up + offsets[None, :, None] * right
    return points.reshape(-1, 3), towards


def crossing(points: np.ndarray, direction: np.ndarray, half: float) -> tuple[np.ndarray, ...]:
    """Return the distances at which rays enter and leave the cube of this half width."""
    # A direction along a face never meets that pair of walls: inf and -inf drop out of max and min.
    with np.errstate(divide="ignore"):
        walls = np.stack([(-half - points) / direction, (half - points) / direction])
    return walls.min(axis=0).max(axis=1), walls.max(axis=0).min(axis=1)


def count_steps(scene: Scene, pixels: int = PIXELS) -> int:
    """Return the number of cells that all rays of the picture cross together."""
    points, direction = ray_points(scene, pixels)
    enter, leave = crossing(points, direction, scene.width / 2)
    hit = enter < leave
    cell = scene.width / scene.cells

    def index(distance: np.ndarray) -> np.ndarray:
        place = (points[hit] + distance[hit, None] * direction + scene.width / 2) / cell
        return np.clip(np.floor(place), 0, scene.cells - 1)

    return int(np.abs(index(leave) - index(enter)).sum() + hit.sum())


def measure(cells: int, pixels: int, repeat: int) -> dict[str, Any]:
    """Return steps and times of both schemes for a cube of `cells` a side."""
    from our_scene import OurScene

    scene = replace(SCENES["core"], cells=cells)
    steps = count_steps(scene, pixels)
    draws: dict[str, Callable[[], float]] = {
        scheme: OurScene(scene, scheme, pixels=pixels).draw for scheme in SCHEMES
    }
    seconds = take_turns(draws, dict.fromkeys(draws, repeat))
    results = {scheme: summary(values) for scheme, values in seconds.items()}
    for result in results.values():
        result["ns_per_step"] = 1e9 * result["min"] / steps
    return {"cells": cells, "rays": pixels**2, "steps": steps} | results


def row(result: dict[str, Any]) -> list[str]:
    """Return the line of one size."""
    numbers = [
        text
        for scheme in SCHEMES
        for text in (
            f"{1e3 * result[scheme]['median']:.1f}",
            f"{1e3 * result[scheme]['min']:.1f}",
            f"{result[scheme]['ns_per_step']:.2f}",
        )
    ]
    return [f"{result['cells']}^3", f"{result['steps'] / 1e6:.2f}", *numbers]


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", type=int, nargs="+", default=[64, 128, 256, 512])
    parser.add_argument("--pixels", type=int, default=PIXELS)
    parser.add_argument("--repeat", type=int, default=7)
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    return parser.parse_args()


def main() -> None:
    """Measure each size and print."""
    options = parse()
    results = [measure(cells, options.pixels, options.repeat) for cells in options.cells]
    columns = [
        f"{s.split('-')[0]} {c}" for s in SCHEMES for c in ("median ms", "min ms", "ns/step")
    ]
    print(table(["cells", "10^6 steps", *columns], [row(result) for result in results]))
    if options.json:
        options.json.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
