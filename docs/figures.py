"""Draw the pictures of the documentation into docs/_static.

python docs/figures.py [NAME ...] [--pixels N] [--output FOLDER]
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from convergence import CELLS, VIEWS, convergence
from drawing import compressed, saved
from figures_architecture import ARCHITECTURE_FIGURES
from figures_cubes import CUBE_FIGURES
from figures_data import DATA_FIGURES
from figures_explorer import EXPLORER_FIGURES
from figures_grids import GRID_FIGURES, example
from figures_images import IMAGE_FIGURES
from figures_media import MEDIA_FIGURES, outflow_walls
from figures_observations import OBSERVATION_FIGURES
from figures_outflow import OUTFLOW_FIGURES
from figures_probe import PROBE_FIGURES
from figures_schemes import raw_or_derived, thin_shell
from figures_stars import STAR_FIGURES
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import voluminous as vm
from voluminous.cli import main as command
from voluminous.geometry import image_axes

FOLDER = Path(__file__).parent / "_static"


def core(target: Path, pixels: int) -> None:
    """What `voluminous demo` writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "core.png"
        command(["demo", "--quiet", "-o", str(path), "--resolution", str(pixels)])
        compressed(path, target)


def axes_volume(cells: int) -> vm.Volume:
    """A faint cube from -1 to 1 with bright edges, and bars from its centre along x, y and z."""
    volume = vm.Volume(vm.CartesianGrid.uniform(cells, (-1.6, 1.6)))
    volume["cube"] = "max(abs(x), abs(y), abs(z)) < 1"
    volume["edge"] = "cube and (abs(x) > 0.97) + (abs(y) > 0.97) + (abs(z) > 0.97) > 1"
    for a, b, c in ("xyz", "yzx", "zxy"):
        volume[f"bar_{a}"] = f"0 < {a} and {a} < 1.5 and max(abs({b}), abs({c})) < 0.07"
    return volume


def axes_medium(glow: float) -> vm.Medium:
    """Red, green and blue bars; `glow` is the brightness of the cube."""
    grey = f"{glow} * cube + 12 * edge"
    bars = ("bar_x + 0.3 * bar_z", "bar_y + 0.5 * bar_z", "bar_z")
    return vm.Coefficients(
        [f"12 * ({bar}) + {grey}" for bar in bars],
        f"12 * (bar_x + bar_y + bar_z) + 4 * edge + {glow} * cube",
    )


def axes(target: Path, pixels: int) -> None:
    """The cube with coloured axes, from four sides."""
    volume = axes_volume(max(16, pixels // 2))
    medium = axes_medium(0.07)
    views = ((0, 0), (90, 0), (90, 90), (60, 30))
    figure = Figure(figsize=(11, 3.1), layout="constrained")
    for place, (incl, phi) in zip(figure.subplots(1, len(views)), views, strict=True):
        camera = vm.Orthographic(incl=incl, phi=phi, width=4.0, resolution=pixels)
        vm.render(volume, medium, camera, samples=2).plot(
            place, exposure=1.0, gamut="clip", colorbar=False
        )
        place.set_title(f"incl={incl}, phi={phi}")
        place.set(xlabel="image x", ylabel="image y")
        name_axes(place, image_axes(incl, phi, 0))
        place.label_outer()
    saved(figure, target)


def name_axes(place: Axes, image: np.ndarray) -> None:
    """Write x, y and z beside the bars; one that points at the observer has no room."""
    for name, color, direction in zip(
        "xyz", ("#ff5040", "#50ff50", "#70a0ff"), np.eye(3), strict=True
    ):
        across, up = image[0] @ direction, image[1] @ direction
        if np.hypot(across, up) > 0.1:
            place.text(1.75 * across, 1.75 * up, name, color=color, ha="center", va="center")


def outflow(cells: int) -> vm.Volume:
    """The walls of a bipolar outflow, and the disc it comes from."""
    volume = outflow_walls(cells)
    volume["walls"] = volume["density"]
    disc = "exp(-0.5 * (z / 0.05)**2) * exp(-(x**2 + y**2)**2 / 0.6**4)"
    volume["density"] = f"walls + 0.3 * {disc}"
    return volume


def moving_gas(n, v, T, v0, width):
    line = vm.math.exp(-0.5 * ((v - v0) / width) ** 2)
    warm = vm.math.clip((vm.math.log10(T) - 1) / 3, 0, 1)
    emitting = n * line
    return [emitting * warm, emitting * 0.4, emitting * (1 - warm)], 0.3 * n


def moving(target: Path, pixels: int) -> None:
    """The outflow in three ranges of velocity, coloured by temperature."""
    volume = outflow(max(16, pixels // 2))
    camera = vm.Orthographic(incl=70, phi=20, width=2.4, resolution=pixels)
    figure = Figure(figsize=(9.6, 3.5), layout="constrained")
    speeds = (-10.0, 0.0, 10.0)
    for place, v0 in zip(figure.subplots(1, len(speeds)), speeds, strict=True):
        medium = vm.Medium.from_function(
            moving_gas,
            fields=["density", "velocity_z", "temperature"],
            channels=3,
            parameters={"v0": v0, "width": 3.0},
        )
        vm.render(volume, medium, camera).plot(place, exposure=1.5, stretch="sqrt", colorbar=False)
        place.set_title(f"velocity_z around {v0:g} km/s", fontsize=10)
        place.label_outer()
    saved(figure, target)


def stretches(target: Path, pixels: int) -> None:
    """One picture through four curves."""
    volume = vm.models.prestellar_core(max(16, pixels // 4))
    medium = vm.Coefficients(["density / 3e21", "density / 6e21", "density / 1e22"], "0")
    image = vm.render(volume, medium, vm.Orthographic(60, 30, resolution=pixels))
    names = ("linear", "sqrt", "asinh", "log")
    figure = Figure(figsize=(9.6, 2.7), layout="constrained")
    for place, stretch in zip(figure.subplots(1, len(names)), names, strict=True):
        image.plot(place, stretch=stretch, colorbar=False)
        place.set_title(f'stretch="{stretch}"', fontsize=10)
        place.set_axis_off()
    saved(figure, target)


def clip(target: Path, pixels: int) -> None:
    """Shells of a core: all of them, behind a plane, and without a corner."""
    volume = vm.models.prestellar_core(max(16, pixels // 4))
    medium = vm.suggest_medium(volume)
    camera = vm.Orthographic(60, 30, width=4e17, resolution=pixels)
    away = camera.lines_of_sight(np.zeros((3, 1)), volume.grid)[:, 0]
    regions = {
        "all of it": None,
        "HalfSpace((0, 0, 0), away)": vm.regions.HalfSpace((0, 0, 0), away),
        "~Box((0, -1e18, 0), (1e18, 0, 1e18))": ~vm.regions.Box((0, -1e18, 0), (1e18, 0, 1e18)),
    }
    images = [vm.render(volume, medium, camera, clip=one, samples=2) for one in regions.values()]
    figure = Figure(figsize=(9.6, 3.4), layout="constrained")
    for place, name, image in zip(figure.subplots(1, 3), regions, images, strict=True):
        image.plot(place, exposure=images[1].exposure, colorbar=False)
        place.set_title(name, fontsize=9)
        place.set_axis_off()
    saved(figure, target)


def perspectives(target: Path, pixels: int) -> None:
    """The cube with its axes from near, on a flat screen and on a dome."""
    volume = axes_volume(max(16, pixels // 2))
    medium = axes_medium(0.1)
    figure = Figure(figsize=(9.6, 3.5), layout="constrained")
    kinds = (("flat", 100), ("spherical", 100), ("spherical", 180))
    for place, (projection, fov) in zip(figure.subplots(1, len(kinds)), kinds, strict=True):
        camera = vm.Perspective(
            (-0.9, -1.5, 1.2), (0, 0, 0), fov, projection=projection, resolution=pixels
        )
        vm.render(volume, medium, camera, samples=2).plot(
            place, exposure=1.0, gamut="clip", colorbar=False
        )
        place.set_title(f'projection="{projection}", fov={fov}', fontsize=10)
    saved(figure, target)


def errors(target: Path, pixels: int) -> None:
    """Error against cells per side, for each scheme, seen along an axis and obliquely."""
    cells = [n for n in CELLS if n <= pixels]
    figure = Figure(figsize=(8.4, 3.6), layout="constrained")
    for place, (title, camera) in zip(
        figure.subplots(1, 2, sharey=True), VIEWS.items(), strict=True
    ):
        for scheme, found in convergence(camera, cells).items():
            style = "s--" if scheme == "olson-kunasz" else "o-"
            place.loglog(cells, found, style, label=scheme)
        for order in (1, 2):
            guide = 0.12 * (cells[0] / np.array(cells)) ** order
            place.loglog(cells, guide, "k:", linewidth=0.8)
            place.text(cells[-1], 0.85 * guide[-1], f"slope {order}", ha="right", va="top")
        place.set(title=title, xlabel="cells per side", xticks=cells, xticklabels=cells)
        place.minorticks_off()
        place.label_outer()
    place.legend(loc="lower left")
    figure.axes[0].set_ylabel("largest error / largest intensity")
    saved(figure, target)


def film(part: str) -> Callable[[Path, int], None]:
    """Return what makes one of the films of an example."""

    def make(target: Path, pixels: int) -> None:
        short = {} if pixels > 100 else {"frames": 3}
        example("films")[part](str(target), min(max(pixels, 101), 160), **short)

    return make


FIGURES: dict[str, Callable[[Path, int], None]] = {
    "core": core,
    "axes": axes,
    "moving": moving,
    "stretches": stretches,
    "clip": clip,
    "perspectives": perspectives,
    "convergence": errors,
    "thin_shell": thin_shell,
    "raw_or_derived": raw_or_derived,
    **ARCHITECTURE_FIGURES,
    **MEDIA_FIGURES,
    **GRID_FIGURES,
    **DATA_FIGURES,
    **IMAGE_FIGURES,
    **CUBE_FIGURES,
    **OBSERVATION_FIGURES,
    **OUTFLOW_FIGURES,
    **PROBE_FIGURES,
    **STAR_FIGURES,
    "film_orbit": film("around"),
    "film_zoom": film("inwards"),
    "film_fade": film("clearing"),
    **EXPLORER_FIGURES,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(FIGURES))
    parser.add_argument("--pixels", type=int, default=400, help="pixels per side of a panel")
    parser.add_argument("--output", type=Path, default=FOLDER)
    args = parser.parse_args()
    for name in args.names or FIGURES:
        suffix = ".webp" if name.startswith(("film_", "explorer_")) else ".png"
        target = args.output / f"{name}{suffix}"
        FIGURES[name](target, args.pixels)
        print(target)


if __name__ == "__main__":
    main()
