"""Physically based volume rendering.

`voluminous` solves the radiative transfer equation along every ray through 3-D data, and gives
pictures and measurements from the same integral. The usual import is ``import voluminous as vm``.

Nothing heavy is imported until it is used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from . import radmc3d  # its scheme and reader have names here
from .llvm import find_llvm_early
from .packages import version as _version

# Public name → module that has it.
_PUBLIC = {
    "Axes": "objects",
    "Blackbody": "physics",
    "Boxes": "objects",
    "CartesianGrid": "grids",
    "Coefficients": "media",
    "ColorBy": "media",
    "Colormap": "media",
    "Cube": "image",
    "Curves": "objects",
    "CylindricalGrid": "grids",
    "Dust": "spectral",
    "Expression": "expressions",
    "FileFormatError": "errors",
    "FreeFree": "spectral",
    "Gaussian": "media",
    "Image": "image",
    "InputError": "errors",
    "Isosurface": "media",
    "Labels": "calibration.labels",
    "Lines": "spectral",
    "Medium": "media",
    "Molecule": "physics",
    "OctreeGrid": "grids",
    "Opacity": "physics",
    "Orthographic": "cameras",
    "PatchGrid": "grids",
    "Panorama": "cameras",
    "Perspective": "cameras",
    "Rectangle": "media",
    "Scene": "scene",
    "SpectralMedium": "spectral",
    "Spheres": "objects",
    "Spectrum": "image",
    "SphericalGrid": "grids",
    "Stars": "objects",
    "Table": "media",
    "UnitsError": "errors",
    "Volume": "volume",
    "VoluminousError": "errors",
    "channels": "image",
    "column": "measuring",
    "demo": "cli.demo",
    "measure": "measuring",
    "moments": "measuring",
    "movie": "movies",
    "observe": "observing",
    "open": "io",
    "orbit": "movies",
    "plan": "large.planning",
    "plot_row": "image.plot",
    "presets": "calibration",
    "probe": "measuring",
    "project": "measuring",
    "render": "drawing",
    "spectrum": "observing",
    "suggest_medium": "calibration",
    "tau_surface": "measuring",
    "view": "viewer.views",
}
# Words of other tools, and what does that here.
_ELSEWHERE = {
    "clip": "vm.render(..., clip=vm.regions.Box(low, high)) draws a part of space, of any region",
    "contour": "vm.Isosurface draws surfaces of one value",
    "crop": "volume.crop(x=(0, 1)) is a smaller volume of the same cells",
    "first_hit": "vm.project(..., how='first') is the first value along each ray",
    "imshow": "image.plot() draws a picture with axes, vm.view(volume) opens the explorer",
    "integrate": "vm.column integrates along rays, vm.measure over cells",
    "load": "vm.open(path) reads a volume, vm.Image.load(path) a picture",
    "mip": "vm.project(volume, 'density', camera, how='max') is the maximum along each ray",
    "plot": "image.plot() draws a picture with axes, vm.view(volume) opens the explorer",
    "read": "vm.open(path) reads a volume, vm.Image.load(path) a picture",
    "save": "volume.save(path) and image.save(path) write files",
    "show": "image.plot() draws a picture with axes, vm.view(volume) opens the explorer",
    "slice": "volume.slice('density', 'z') is a slice",
    "transfer_function": "a medium is one: vm.Gaussian, vm.Table, vm.Colormap …",
}
_MODULES = ("errors", "io", "math", "measuring", "models", "movies", "radmc3d", "regions")

__all__ = sorted(["__version__", *_MODULES, *_PUBLIC])

if TYPE_CHECKING:
    from . import errors, io, math, measuring, models, movies, regions
    from .calibration import presets, suggest_medium
    from .calibration.labels import Labels
    from .cameras import Orthographic, Panorama, Perspective
    from .cli.demo import demo
    from .drawing import render
    from .errors import (
        FileFormatError,
        InputError,
        UnitsError,
        VoluminousError,
    )
    from .expressions import Expression
    from .grids import CartesianGrid, CylindricalGrid, OctreeGrid, PatchGrid, SphericalGrid
    from .image import Cube, Image, Spectrum, channels
    from .image.plot import plot_row
    from .io import open
    from .large.planning import plan
    from .measuring import (
        column,
        measure,
        moments,
        probe,
        project,
        tau_surface,
    )
    from .media import (
        Coefficients,
        ColorBy,
        Colormap,
        Gaussian,
        Isosurface,
        Medium,
        Rectangle,
        Table,
    )
    from .movies import movie, orbit
    from .objects import Axes, Boxes, Curves, Spheres, Stars
    from .observing import observe, spectrum
    from .physics import Blackbody, Molecule, Opacity
    from .scene import Scene
    from .spectral import Dust, FreeFree, Lines, SpectralMedium
    from .viewer.views import view
    from .volume import Volume


find_llvm_early()


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version()
    if name in _PUBLIC:
        value = getattr(importlib.import_module(f".{_PUBLIC[name]}", __name__), name)
        globals()[name] = value
        return value
    if name in _MODULES:
        return importlib.import_module(f".{name}", __name__)
    if name in _ELSEWHERE:
        raise AttributeError(f"voluminous has no {name}: {_ELSEWHERE[name]}")
    from .errors import unknown_name

    if not name.startswith("_"):
        for module in _MODULES:
            found = getattr(importlib.import_module(f".{module}", __name__), name, None)
            if getattr(found, "__module__", "").startswith(__name__):
                raise AttributeError(f"voluminous has no {name}: it is vm.{module}.{name}")
    raise AttributeError(f"voluminous: {unknown_name('name', name, __all__)}")


def __dir__() -> list[str]:
    return sorted(__all__)
