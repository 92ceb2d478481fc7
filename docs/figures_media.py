"""Pictures of "Isosurfaces" and "Choosing a medium"."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from astropy import units as u
from drawing import saved
from matplotlib.figure import Figure

import voluminous as vm

BLUE, ORANGE = (0.45, 0.65, 1.0), (1.0, 0.6, 0.25)


def row(
    target: Path,
    panels: dict[str, vm.Image],
    size: tuple[float, float],
    colors: int | None = 256,
    **tone: Any,
) -> None:
    """Draw images side by side, each under its title."""
    figure = Figure(figsize=size, layout="constrained")
    for place, (title, image) in zip(figure.subplots(1, len(panels)), panels.items(), strict=True):
        image.plot(place, **{"exposure": 1, **tone})
        place.set_title(title, fontsize=10)
        place.set_axis_off()
    saved(figure, target, 100, colors)


def two_balls(cells: int) -> vm.Volume:
    """Two balls of the same size, one with a sharp edge and one with a soft one."""
    volume = vm.Volume(
        vm.CartesianGrid.uniform((2 * cells, cells, cells), [(-2, 2), (-1, 1), (-1, 1)])
    )
    volume["sharp"] = "1 / (1 + exp((sqrt((x + 1)**2 + y**2 + z**2) - 0.6) / 0.05))"
    volume["soft"] = "1 / (1 + exp((sqrt((x - 1)**2 + y**2 + z**2) - 0.6) / 0.15))"
    volume["density"] = "max(sharp, soft)"
    return volume


def shell_or_surface(target: Path, pixels: int) -> None:
    """A shell is thick where the field varies slowly; a surface is the same everywhere."""
    volume = two_balls(64)
    camera = vm.Orthographic(0, 0, width=(4, 2), resolution=(2 * pixels, pixels))
    media = {
        'Gaussian("density", 0.5, 0.1, …)': vm.Gaussian("density", 0.5, 0.1, BLUE, 0.5, 0.2),
        'Isosurface("density", 0.5, …)': vm.Isosurface("density", 0.5, BLUE, 0.5),
    }
    panels = {title: vm.render(volume, medium, camera) for title, medium in media.items()}
    row(target, panels, (10, 2.8), exposure=0.7)


def blobs(cells: int) -> vm.Volume:
    """Four blobs of gas, some of which touch."""
    volume = vm.Volume(vm.CartesianGrid.uniform(cells, (-1, 1)))
    places = ((0.42, 0.0, 0.1), (-0.3, 0.35, -0.1), (-0.25, -0.4, 0.15), (0.15, 0.1, -0.45))
    volume["density"] = " + ".join(
        f"exp(-(({x} - x)**2 + ({y} - y)**2 + ({z} - z)**2) / 0.08)" for x, y, z in places
    )
    return volume


def isosurfaces(target: Path, pixels: int) -> None:
    """The options of an isosurface."""
    volume = blobs(48)
    camera = vm.Orthographic(60, 30, width=1.9, resolution=pixels)
    media = {
        "opacity=0.3": vm.Isosurface("density", 0.4, BLUE, 0.3),
        "level=[0.2, 0.5, 0.8]": vm.Isosurface(
            "density", level=[0.2, 0.5, 0.8], color="plasma", opacity=0.35
        ),
        'density="gradient"': vm.Isosurface("density", 0.4, BLUE, 0.3, density="gradient"),
        "opacity=1, shading=0.8": vm.Isosurface("density", 0.4, BLUE, 1, shading=0.8),
    }
    panels = {
        title: vm.render(volume, medium, camera, antialias="adaptive")
        for title, medium in media.items()
    }
    row(target, panels, (11, 3.1))


def antialiasing(target: Path, pixels: int) -> None:
    """One ray per pixel, and as many as it takes."""
    volume = blobs(48)
    camera = vm.Orthographic(60, 30, width=0.9, shift=(0.2, 0.2), resolution=max(16, pixels // 6))
    surface = vm.Isosurface("density", level=[0.2, 0.5, 0.8], color="plasma", opacity=0.35)
    panels = {
        f"antialias={way!r}": vm.render(volume, surface, camera, antialias=way)
        for way in (None, "adaptive")
    }
    row(target, panels, (7, 3.7))


def variables(target: Path, pixels: int) -> None:
    """A surface of density, for gas of some velocities, coloured by temperature."""
    volume = outflow_walls(64)
    warmth = vm.ColorBy("temperature", "inferno", 10, 1e4, norm="log")
    camera = vm.Orthographic(incl=70, phi=20, width=2.4, resolution=pixels)
    media = {
        "one colour": vm.Isosurface("density", 0.5, BLUE, 0.5),
        "colour by temperature": vm.Isosurface("density", 0.5, warmth, 0.5),
        "… where |velocity_z| > 5": vm.Isosurface(
            "density", 0.5, warmth, 0.5, where="abs(velocity_z) > 5"
        ),
    }
    panels = {title: vm.render(volume, m, camera, samples=2) for title, m in media.items()}
    row(target, panels, (9.6, 3.5), colors=None)


def outflow_walls(cells: int) -> vm.Volume:
    """The walls of a bipolar outflow, the faster and hotter the further from its centre."""
    volume = vm.Volume(vm.CartesianGrid.uniform(cells, (-1, 1)))
    volume["density"] = "exp(-0.5 * ((sqrt(x**2 + y**2) - 0.15 - 0.5 * abs(z)) / 0.06)**2)"
    volume["velocity_z"] = "20 * z"
    volume["temperature"] = "10**(1 + 3 * abs(z))"
    return volume


def calibrated(target: Path, pixels: int) -> None:
    """A path length too short, too long, and measured."""
    volume = vm.models.prestellar_core(64)
    camera = vm.Orthographic(60, 30, width=0.2 * u.pc, resolution=pixels)
    panels = {}
    for length in (1e15, 1e18, "auto"):
        shell = vm.Gaussian("log10(density)", 3.7, 0.02, (0.16, 0.24, 0.36), 0.3, length)
        found = shell.calibrated(volume).path_length
        title = f"path_length={found:.2g}" + (' cm: "auto"' if length == "auto" else " cm")
        panels[title] = vm.render(volume, shell, camera)
    row(target, panels, (9.6, 3.5), gamut="clip")


def automatic(target: Path, pixels: int) -> None:
    """What `vm.suggest_medium` makes of data of which nothing is said."""
    camera = vm.Orthographic(60, 30, width=1.9, resolution=pixels)
    core = vm.models.prestellar_core(64)
    core_camera = vm.Orthographic(60, 30, width=0.25 * u.pc, resolution=pixels)
    steps = (2e4, 4e4, 6e4, 8e4)
    flat = sum(vm.Gaussian("density", v, 2e3, BLUE, 0.2, "auto") for v in steps)
    gas = blobs(64)
    gas["density"] = "density + 0.05"
    panels = {
        "core: equal steps of density": vm.render(core, flat, core_camera),
        "vm.suggest_medium(core): in log10(density)": vm.render(
            core, vm.suggest_medium(core), core_camera
        ),
        "vm.suggest_medium(gas): in density": vm.render(gas, vm.suggest_medium(gas), camera),
    }
    row(target, panels, (9.6, 3.5), colors=None, exposure=None)


def transfer(target: Path, pixels: int) -> None:
    """What `Medium.plot` draws, of shells and of a colormap."""
    core = vm.models.prestellar_core(64)
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    media = (
        vm.suggest_medium(core),
        vm.Colormap("density", "inferno", norm="log", opacity=lambda p: p**2),
    )
    for medium, axes in zip(media, figure.subplots(1, 2), strict=True):
        medium.plot(core, axes)
    saved(figure, target, max(40, pixels // 4))


MEDIA_FIGURES: dict[str, Callable[[Path, int], None]] = {
    "shell_or_surface": shell_or_surface,
    "isosurfaces": isosurfaces,
    "antialiasing": antialiasing,
    "variables": variables,
    "calibrated": calibrated,
    "automatic": automatic,
    "transfer": transfer,
}
