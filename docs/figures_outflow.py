"""Pictures of the gallery of outflows: of the snapshots, or of what stands in for them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from drawing import saved
from figures_data import data_folder
from figures_grids import example
from matplotlib.figure import Figure

import voluminous as vm

MINIHALO = "enzo_minihalo/moving7_0010"
IONISED = "ramses_hii_outflow/output_00003"
OUTFLOW = "athena_disc_outflow/DiskOutflow_t0.20.athdf"
# With fewer pixels nobody looks at it.
_LEAST = 101


def volume_of(script: dict[str, Any], place: str, pixels: int) -> vm.Volume:
    """Return what an example shows: the snapshot if it is there, else what stands in for it."""
    path = data_folder() / place
    there = pixels >= _LEAST and path.exists()
    volume: vm.Volume = script["snapshot"](path) if there else script["stand_in"]()
    return volume


def gallery_shells(target: Path, pixels: int) -> None:
    """A collapsing minihalo, and an outflow driven by ionisation."""
    halo, flow = example("minihalo"), example("outflow")
    volume = volume_of(halo, MINIHALO, pixels)
    left = vm.render(volume, halo["shells"](), halo["camera"](volume, pixels))
    volume = volume_of(flow, IONISED, pixels)
    objects = [flow["star"]()]
    right = vm.render(volume, flow["medium"](), flow["camera"](pixels), objects=objects)
    figure = Figure(figsize=(8, 4), facecolor="black")
    figure.subplots_adjust(0, 0, 1, 1, wspace=0.01)
    for place, image in zip(figure.subplots(1, 2), (left, right), strict=True):
        image.plot(place, scale_bar=True, colorbar=False)
        place.set_axis_off()
    saved(figure, target, 100, colors=None)


def gallery_totals(target: Path, pixels: int) -> None:
    """Fast gas coloured by its temperature, and its totals from many sides."""
    script, fine = example("outflow_diagnostic"), pixels >= _LEAST
    volume = volume_of(script, OUTFLOW, pixels) if fine else script["stand_in"](levels=0)
    figure = Figure(figsize=(8, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.25))
    script["picture"](volume, pixels).plot(left, exposure=1, colorbar=False)
    left.set_axis_off()
    views = script["cameras"](20 if fine else 2, pixels=min(pixels, 200))
    script["plot"](script["diagnosed"](volume, views), right)
    saved(figure, target, 100, colors=None)


OUTFLOW_FIGURES: dict[str, Callable[[Path, int], None]] = {
    "gallery_shells": gallery_shells,
    "gallery_totals": gallery_totals,
}
