"""Pictures of the gallery, made by the scripts in `examples`."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drawing import saved
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

import voluminous as vm

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def example(name: str) -> dict[str, Any]:
    """Return what an example defines."""
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))


def gallery_disc(target: Path, pixels: int) -> None:
    """A disc from outside, and below from two places inside it."""
    script = example("disc")
    volume, dust = script["disc"](max(16, pixels * 2 // 5)), script["medium"]()
    images = {
        name: vm.render(volume, dust, camera)
        for name, camera in script["cameras"](2 * pixels).items()
    }
    figure = Figure(figsize=(8, 6.75), facecolor="black")
    grid = GridSpec(2, 2, figure, 0, 0, 1, 1, wspace=0.01, hspace=0.01, height_ratios=(2, 1))
    for name, where in zip(images, (grid[0, :], grid[1, 0], grid[1, 1]), strict=True):
        place = figure.add_subplot(where)
        images[name].plot(place, stretch="asinh", exposure=0.8, colorbar=False)
        place.set_axis_off()
    saved(figure, target, 100, colors=None)


def row(target: Path, panels: dict[str, vm.Image]) -> None:
    """Draw images side by side without gaps, each with words in its corner."""
    figure = Figure(figsize=(2.4 * len(panels), 2.4), facecolor="black")
    places = figure.subplots(1, len(panels))
    figure.subplots_adjust(0, 0, 1, 1, wspace=0.01)
    for place, (title, image) in zip(places, panels.items(), strict=True):
        image.plot(place, exposure=1, colorbar=False)
        place.set_axis_off()
        place.text(0.04, 0.94, title, color="white", transform=place.transAxes, fontsize=9)
    saved(figure, target, 100, colors=None)


def gallery_zoom(target: Path, pixels: int) -> None:
    """Four magnifications of one volume."""
    script = example("zoom")
    fine = pixels > 100  # else a picture that is only to be made, quickly
    volume, surfaces = script["matter"](script["tree"](cells=8 if fine else 3)), script["medium"]()
    panels = {}
    for width, camera in zip(script["WIDTHS"], script["cameras"](pixels), strict=True):
        panels[f"{width:g} wide"] = vm.render(
            volume, surfaces, camera, samples=2, tolerance=1e-3 if fine else None
        )
    row(target, panels)


def gallery_patches(target: Path, pixels: int) -> None:
    """A knot on a base grid alone, with patches, and with patches on these."""
    script = example("patches")
    cells = 24 if pixels > 100 else 12
    camera = vm.Orthographic(20, 30, width=2.2, resolution=pixels)
    panels = {}
    for levels, title in enumerate(("cells of 0.1", "and of 0.05", "and of 0.017")):
        volume = script["string"](script["grid"](levels, cells))
        panels[title] = vm.render(volume, script["medium"](), camera, samples=2)
    row(target, panels)


GRID_FIGURES: dict[str, Callable[[Path, int], None]] = {
    "gallery_disc": gallery_disc,
    "gallery_zoom": gallery_zoom,
    "gallery_patches": gallery_patches,
}
