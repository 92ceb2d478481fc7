"""Pictures of "Which scheme?": one thin shell under all schemes, and what is interpolated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from astropy import units as u
from drawing import saved
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image as Pillow

import voluminous as vm

PEERS = Path(__file__).parent / "_static" / "peers"
CELLS, FRAME = 64, 0.17
LEVEL, SIGMA = 3.7, 0.01
COLOR, OPACITY = np.array([0.4, 0.5, 0.9]), 0.2
# The median thickness of the shell, which path_length="auto" finds: √(2π) σ over the gradient.
PATH_LENGTH = 6.67e15


def thin_shell(target: Path, pixels: int) -> None:
    """A shell of a fifth of a cell, under all schemes, VTK and the exact integral."""
    core = vm.models.prestellar_core(CELLS)
    camera = vm.Orthographic(60, 30, width=FRAME * u.pc, resolution=pixels)
    shell = vm.Gaussian("log10(density)", LEVEL, SIGMA, COLOR, OPACITY, PATH_LENGTH)
    surface = vm.Isosurface("log10(density)", LEVEL, COLOR / OPACITY, 0.2)
    schemes = ("first-order", "second-order", "olson-kunasz", "post-classified")
    images = {name: vm.render(core, shell, camera, scheme=name).intensity for name in schemes}
    images["exact, of 1/r² itself"] = exact_shell(pixels)[..., None] * COLOR / OPACITY
    images["VTK, 1 sample per cell"] = vtk_shell(1)[..., None] * COLOR / OPACITY
    images["VTK, 10 samples per cell"] = vtk_shell(10)[..., None] * COLOR / OPACITY
    images["Isosurface, post-classified"] = 3 * vm.render(core, surface, camera).intensity
    figure = Figure(figsize=(10, 5.4), layout="constrained")
    for place, (title, intensity) in zip(figure.subplots(2, 4).flat, images.items(), strict=True):
        vm.Image(intensity).plot(place, exposure=OPACITY / COLOR.max(), colorbar=False)
        place.set_title(title, fontsize=10)
        place.set_axis_off()
    saved(figure, target, dpi=100)


def exact_shell(pixels: int) -> np.ndarray:
    """Return the intensity over the source function for n = 28 (r/pc)⁻² cm⁻³ itself."""
    x = (np.arange(pixels) + 0.5) / pixels - 0.5
    b = FRAME * np.hypot(x[:, None], x)
    edges = np.unique(b)[:: max(1, np.unique(b).size // 2000)]
    depth = np.interp(b, edges, [optical_depth(e) for e in edges])
    return -np.expm1(-depth)


def optical_depth(impact: float) -> float:
    """Return the optical depth of the shell along a line at a distance from the centre, in pc."""
    s = np.linspace(0.0, 0.1, 20_000)
    logn = np.log10(28.0 / (impact**2 + s**2 + 1e-12))
    shape = np.exp(-0.5 * ((logn - LEVEL) / SIGMA) ** 2)
    length = 2 * (shape.sum() - 0.5 * shape[0]) * (s[1] - s[0]) * vm.models.PARSEC
    return float(length * OPACITY / PATH_LENGTH)


def vtk_shell(samples: int) -> np.ndarray:
    """Return what `vtk_shell.py` has drawn, from 0 to 1."""
    with Pillow.open(PEERS / f"vtk_shell_{samples}.png") as picture:
        return np.asarray(picture)[::-1] / 255


def raw_or_derived(target: Path, pixels: int) -> None:
    """The logarithm of an interpolated density, and an interpolated logarithm."""
    volume = vm.Volume(vm.CartesianGrid.uniform(16, (-1, 1)))
    volume["density"] = "10**(6 - 8 * r)"
    volume["logn"] = "log10(density)"
    figure = Figure(figsize=(10, 3.5), layout="constrained")
    profile, *places = figure.subplots(1, 3)
    draw_profiles(profile, volume)
    camera = vm.Orthographic(20, 30, width=1.25, resolution=pixels)
    for place, expr in zip(places, ("log10(density)", "logn"), strict=True):
        surface = vm.Isosurface(expr, 2.0, (0.65, 0.8, 1.0), opacity=1, shading=1)
        vm.render(volume, surface, camera, antialias="adaptive").plot(
            place, exposure=1, colorbar=False
        )
        angle = np.linspace(0, 2 * np.pi, 200)
        place.plot(0.5 * np.cos(angle), 0.5 * np.sin(angle), "w:", linewidth=1)
        place.set_title(f'Isosurface("{expr}", 2)', fontsize=10)
        place.set_axis_off()
    saved(figure, target, dpi=100)


def draw_profiles(place: Axes, volume: vm.Volume) -> None:
    """Draw both interpolants along a row of cells beside the axis, and the truth."""
    x, row = volume.grid.centers[0], volume.array("density")[:, 8, 8]
    fine = np.linspace(0, 0.8, 400)
    place.plot(fine, np.log10(np.interp(fine, x, row)), label="log10(density)")
    place.plot(fine, np.interp(fine, x, np.log10(row)), label="logn")
    place.plot(fine, 6 - 8 * np.sqrt(fine**2 + 2 * x[8] ** 2), "k:", label="truth")
    place.plot(x, np.log10(row), "ko", markersize=4, label="cells")
    place.set(xlim=(0, 0.8), ylim=(-0.5, 5.5), xlabel="x", ylabel="log10(density)")
    place.set_title("along a row of cells", fontsize=10)
    place.legend(fontsize=8)
