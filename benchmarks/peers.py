"""Draw one scene with VTK, yt and voluminous in one process; print times, ratios and brightness.

    python benchmarks/peers.py --repeat 20
    python benchmarks/peers.py --only vtk first --scene core_opaque --pictures pictures

Contestants take turns, so that load from elsewhere meets all of them. The last column is the mean
intensity of the picture: it says whether they all drew the same thing.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from scenes import SCENES, Scene
from timing import ratios, summary, table, take_turns

REFERENCE = "vtk"


class Renderer(Protocol):
    """What a contestant can do."""

    def draw(self) -> float: ...
    def picture(self) -> np.ndarray: ...
    def describe(self) -> str: ...


def vtk(linear: bool) -> Callable[[Scene], Renderer]:
    """VTK's ray caster, scalars constant in a cell or interpolated."""

    def build(scene: Scene) -> Renderer:
        from vtk_scene import VtkScene

        return VtkScene(scene, linear)

    return build


def yt(samples: int) -> Callable[[Scene], Renderer]:
    """Make yt draw with this many samples per cell."""

    def build(scene: Scene) -> Renderer:
        from yt_scene import YtScene

        return YtScene(scene, samples)

    return build


def ours(scheme: str, precision: str) -> Callable[[Scene], Renderer]:
    """Make voluminous draw with a scheme and a precision."""

    def build(scene: Scene) -> Renderer:
        from our_scene import OurScene

        return OurScene(scene, scheme, precision)

    return build


CONTESTANTS: dict[str, Callable[[Scene], Renderer]] = {
    REFERENCE: vtk(linear=False),
    "vtk-linear": vtk(linear=True),
    "first": ours("first-order", "single"),
    "second": ours("second-order", "single"),
    "first-double": ours("first-order", "double"),
    "second-double": ours("second-order", "double"),
    "yt": yt(samples=10),  # what create_scene gives
    "yt-1": yt(samples=1),
}


def built(names: list[str], scene: Scene) -> dict[str, Renderer]:
    """Build the contestants that can be built here; say why the others cannot."""
    renderers: dict[str, Renderer] = {}
    for name in names:
        try:
            renderers[name] = CONTESTANTS[name](scene)
        except (ImportError, AttributeError) as error:
            print(f"{name}: not available ({error})")
    return renderers


def compete(scene: Scene, options: argparse.Namespace) -> dict[str, Any]:
    """Run all contestants on a scene; return their numbers."""
    renderers = built(options.only, scene)
    repeats = {n: options.yt_repeat if n.startswith("yt") else options.repeat for n in renderers}
    seconds = take_turns({name: one.draw for name, one in renderers.items()}, repeats)
    if options.pictures:
        save_pictures(options.pictures, scene, renderers)
    return {
        name: summary(seconds[name])
        | {"mean_intensity": float(np.mean(one.picture())), "version": one.describe()}
        | {
            f"to_{peer}": ratios(seconds[name], seconds[peer])
            for peer in (REFERENCE, "vtk-linear", "first", "yt", "yt-1")
            if peer in seconds
        }
        for name, one in renderers.items()
    }


def save_pictures(folder: Path, scene: Scene, renderers: dict[str, Renderer]) -> None:
    """Save each picture as PNG, all on the same scale of brightness."""
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    pictures = {name: np.asarray(one.picture(), dtype=float) for name, one in renderers.items()}
    brightest = max(picture.max() for picture in pictures.values())
    for name, picture in pictures.items():
        bytes_ = np.rint(np.clip(picture[::-1] / brightest, 0, 1) * 255).astype(np.uint8)
        Image.fromarray(bytes_).save(folder / f"{scene.name}_{name}.png")


def row(name: str, result: dict[str, Any]) -> list[str]:
    """Return one contestant's line of the table."""
    relative = result.get(f"to_{REFERENCE}")
    return [
        name,
        f"{1e3 * result['median']:.1f}",
        f"{1e3 * result['min']:.1f}",
        *(f"{relative[k]:.2f}" if relative else "-" for k in ("median", "min", "round")),
        f"{result['mean_intensity']:.4f}",
    ]


def report(scene: Scene, results: dict[str, Any]) -> str:
    """Return the table of one scene."""
    header = ["", "median ms", "min ms", "/VTK median", "/VTK min", "/VTK round", "mean I"]
    rows = [row(name, result) for name, result in results.items()]
    versions = sorted({result["version"] for result in results.values()})
    return "\n".join([f"scene {scene.name}: {'; '.join(versions)}", table(header, rows)])


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeat", type=int, default=15, help="rounds")
    parser.add_argument("--yt-repeat", type=int, default=3, help="rounds in which yt takes part")
    parser.add_argument("--only", nargs="+", choices=list(CONTESTANTS), default=list(CONTESTANTS))
    parser.add_argument("--scene", nargs="+", choices=list(SCENES), default=["core", "core_wide"])
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    parser.add_argument("--pictures", type=Path, help="save the pictures in this folder")
    return parser.parse_args()


def main() -> None:
    """Run the contest."""
    options = parse()
    everything = {"cpus": os.cpu_count(), "load_before": os.getloadavg()}
    for name in options.scene:
        everything[name] = compete(SCENES[name], options)
        print(report(SCENES[name], everything[name]), end="\n\n")
    everything["load_after"] = os.getloadavg()
    if options.json:
        options.json.write_text(json.dumps(everything, indent=2) + "\n")


if __name__ == "__main__":
    main()
