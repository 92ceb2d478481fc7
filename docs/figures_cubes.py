"""Pictures of "Cubes and spectra": a turning disc in a line of CO."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from astropy import units as u
from drawing import saved
from matplotlib.figure import Figure

import voluminous as vm


def carbon_monoxide() -> vm.Molecule:
    """The lowest levels of CO."""
    levels = {"energies": [0.0, 3.845033413, 11.534919938], "weights": [1, 3, 5]}
    lines = {"up": [1, 2], "low": [0, 1], "einstein_a": [7.203e-8, 6.91e-7]}
    rest = [115.2712018e9, 230.538e9]
    return vm.Molecule("CO", 28.0, **levels, labels="012", **lines, frequencies=rest)


def disc(cells: int) -> vm.Volume:
    """A Keplerian disc around a star of one solar mass."""
    sides = ((-400, 400), (-400, 400), (-200, 200))
    volume = vm.Volume(vm.CartesianGrid.uniform((cells, cells, cells // 2), sides, unit="au"))
    volume["radius"] = "sqrt(x**2 + y**2 + 400 au**2) / (100 au)"
    volume["h2"] = (
        "3e7 cm**-3 * exp(-0.5 * (z / (15 au * radius))**2 - (radius / 1.5)**2) / radius**2"
    )
    volume["T"] = "30 K / sqrt(radius)"
    volume["velocity_x"] = "-2.98 km/s * y / (100 au) / radius**1.5"
    volume["velocity_y"] = "2.98 km/s * x / (100 au) / radius**1.5"
    volume["velocity_z"] = "0 km/s * radius"
    return volume


def disc_cube(pixels: int) -> vm.Cube:
    """The disc in CO 2-1 and its dust, seen from 45 degrees."""
    gas = vm.Lines(
        "h2 * 1e-4",
        carbon_monoxide(),
        temperature="T",
        velocity="velocity",
        turbulence=0.1 * u.km / u.s,
    )
    dust = vm.Dust("h2 * 3.9e-26 g", "T", vm.Opacity.power_law(2.3, 1.3 * u.mm, beta=1.0))
    channels = vm.channels(-4, 4, 41, line="CO 2-1")
    camera = vm.Orthographic(incl=45, width=850 * u.au, resolution=max(32, pixels))
    volume = disc(max(16, pixels // 2))
    return vm.observe(volume, gas + dust, camera, velocities=channels, distance=140 * u.pc)


def cube_channels(target: Path, pixels: int) -> None:
    """Channel maps through a beam."""
    line = disc_cube(pixels).subtract_continuum().convolve((0.4 * u.arcsec, 0.3 * u.arcsec, 40))
    panels = line.to("K").channel_maps(20).plot()
    saved(panels[0].figure, target, dpi=80)


def cube_maps(target: Path, pixels: int) -> None:
    """The cube in colours, two moments, a cut and the spectrum."""
    cube = disc_cube(pixels).to("arcsec")
    line = cube.subtract_continuum().to("K")
    figure = Figure(figsize=(13.5, 3.1), layout="constrained")
    colours, first, second, cut, spectrum = figure.subplots(1, 5, width_ratios=(1, 1.1, 1.1, 1, 1))
    cube.plot(colours, stretch="asinh", colorbar=False)
    line.moment(0).plot(first, colormap="inferno")
    line.moment(1, threshold=1 * u.K).plot(second)
    cube.position_velocity((-3, 0), (3, 0)).plot(cut, colormap="inferno", colorbar=False)
    cut.set_aspect("auto")
    cube.total().plot(spectrum)
    names = ("in colours", "moment 0", "moment 1", "cut along x", "total")
    for place, name in zip((colours, first, second, cut, spectrum), names, strict=True):
        place.set_title(name)
    saved(figure, target)


CUBE_FIGURES: dict[str, Callable[[Path, int], None]] = {
    "cube_channels": cube_channels,
    "cube_maps": cube_maps,
}
