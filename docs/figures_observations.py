"""Pictures of "Synthetic observations", made by the lines that the page shows.

The snapshot is not part of the repository: see `CONTRIBUTING.md`.
"""

from __future__ import annotations

import functools
import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from astropy import units as u
from drawing import saved
from figures_data import data_folder
from matplotlib.figure import Figure

import voluminous as vm

PAGE = Path(__file__).with_name("synthetic_observations.md")
COLUMNS = {"vmin": 1e23, "vmax": 1e26, "stretch": "log"}
SPEEDS = {"vmin": -5, "vmax": 5}
_BLOCK = re.compile(r"^```py(?:thon)?\n(.*?)^```$", re.M | re.S)


@functools.cache
def observed(pixels: int) -> dict[str, Any]:
    """Run all lines of the page beside its snapshot, and return what they make.

    Raises
    ------
    FileNotFoundError
        If the snapshot is not there.
    """
    snapshot = data_folder() / "phantom_disc" / "disc_00001.h5"
    if not snapshot.is_file():
        raise FileNotFoundError(f"no {snapshot}; set VOLUMINOUS_TEST_DATA")
    names: dict[str, Any] = {"__name__": "__main__"}
    code = "\n".join(_BLOCK.findall(PAGE.read_text(encoding="utf-8")))
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            Path(snapshot.name).symlink_to(snapshot)
            exec(code.replace("resolution=300", f"resolution={min(pixels, 300)}"), names)
        finally:
            os.chdir(before)
    return names


def on_sky(image: vm.Image) -> vm.Image:
    """Return an image with axes in arcseconds, as those of cubes."""
    return image.replace(distance=140 * u.pc).to("arcsec")


def observed_dust(target: Path, pixels: int) -> None:
    """The column of the gas, its dust's brightness, and what a telescope shows of it."""
    names = observed(pixels)
    figure = Figure(figsize=(12.5, 3.3), layout="constrained")
    column, kelvin, seen = figure.subplots(1, 3)
    on_sky(names["column"]).plot(column, colormap="viridis", **COLUMNS)
    names["kelvin"].plot(kelvin, colormap="inferno")
    names["dust_seen"].plot(seen, colormap="inferno")
    titles = ("H₂ column", "0.87 mm", "through beam and noise")
    for place, title in zip((column, kelvin, seen), titles, strict=True):
        place.set_title(title)
    for place in (kelvin, seen):
        place.set_ylabel("")
    saved(figure, target, 90)


def observed_channels(target: Path, pixels: int) -> None:
    """Channel maps of the line."""
    saved(observed(pixels)["panels"][0].figure, target, 80)


def observed_moments(target: Path, pixels: int) -> None:
    """Moments of the line beside the true ones."""
    names = observed(pixels)
    figure = Figure(figsize=(8.4, 6.6), layout="constrained")
    (area, column), (speed, truth) = figure.subplots(2, 2)
    names["area"].plot(area, colormap="inferno")
    on_sky(names["column"]).plot(column, colormap="viridis", **COLUMNS)
    names["speed"].plot(speed, **SPEEDS)
    on_sky(names["truth"]).plot(truth, **SPEEDS)
    titles = ("moment 0", "true column", "moment 1", "true mean velocity")
    for place, title in zip((area, column, speed, truth), titles, strict=True):
        place.set_title(title)
    saved(figure, target, 90)


def observed_spectrum(target: Path, pixels: int) -> None:
    """The spectrum of the disc."""
    figure = Figure(figsize=(5.5, 2.8), layout="constrained")
    observed(pixels)["spectrum"].plot(figure.subplots())
    saved(figure, target, 90)


OBSERVATION_FIGURES: dict[str, Callable[[Path, int], None]] = {
    "observed_dust": observed_dust,
    "observed_channels": observed_channels,
    "observed_moments": observed_moments,
    "observed_spectrum": observed_spectrum,
}
