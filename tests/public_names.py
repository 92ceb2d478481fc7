"""Every public function, class and method with arguments that are right, and cheap."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from astropy import units as u

import voluminous as vm
from voluminous import regions

mpl.use("agg")
VOLUME = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1), unit="au"))
for _name, _text in {
    "a": "x / (1 au)",
    "density": "1e6 g / (1 cm)**3",
    "temperature": "30 K",
}.items():
    VOLUME[_name] = _text
for _axis in "xyz":
    VOLUME[f"velocity_{_axis}"] = "1 km / s"
SHELL = vm.Gaussian("a", 0.3, 0.1, 1.0, 0.3, 1.0)
CAMERA = vm.Orthographic(resolution=2)
CO = {
    "name": "CO",
    "weight": 28,
    "energies": [0, 3.845],
    "weights": [1, 3],
    "labels": ["0", "1"],
    "up": [1],
    "low": [0],
    "einstein_a": [7.203e-8],
    "frequencies": [115.2712018e9],
}
KAPPA = {"wavelengths": [1, 1000], "absorption": [10, 0.1]}
DUST = vm.Dust("1e-18 * density", "temperature", vm.Opacity(**KAPPA))
GAS = {"density": "1e20 * density / (1 g)", "molecule": vm.Molecule(**CO)}
AXIS = vm.channels(-1, 1, 3, line="CO 1-0", rest=115.2712018 * u.GHz)
IMAGE = vm.render(VOLUME, SHELL, CAMERA)
CUBE = vm.Cube(
    np.arange(12.0).reshape(2, 2, 3),
    spectral=AXIS,
    intensity_unit="Jy / sr",
    unit="au",
    x=[-0.5, 0.5],
    y=[-0.5, 0.5],
    distance=140 * u.pc,
)
SPECTRUM = vm.Spectrum([10, 100, 1000], [1, 2, 3], "Jy", distance=140 * u.pc)
SCENE = {"volume": VOLUME, "medium": SHELL, "camera": CAMERA}
WITH = {"expr": "a", "opacity": 0.3, "path_length": 1.0}

# Name: what is called, and what it needs; all else that it takes is tried, too.
CALLS = {
    "Axes": (vm.Axes, {"volume": VOLUME}),
    "Blackbody": (vm.Blackbody, {"temperature": 5000}),
    "Boxes": (vm.Boxes, {"volume": VOLUME}),
    "CartesianGrid": (vm.CartesianGrid, {axis: [0, 1, 2] for axis in "xyz"}),
    "CartesianGrid.uniform": (vm.CartesianGrid.uniform, {"shape": 2, "bounds": (-1, 1)}),
    "Coefficients": (vm.Coefficients, {"emissivity": "a", "extinction": 1}),
    "ColorBy": (vm.ColorBy, {"expr": "a", "cmap": "viridis", "vmin": 0, "vmax": 1}),
    "Colormap": (vm.Colormap, {**WITH, "cmap": "viridis", "vmin": 0, "vmax": 1}),
    "Cube": (vm.Cube, {"intensity": np.ones((2, 2, 3)), "spectral": AXIS}),
    "Curves": (vm.Curves, {"points": [[0, 0, 0], [1, 1, 1]]}),
    "CylindricalGrid": (vm.CylindricalGrid, {"R": [1, 2], "phi": [0, 3], "z": [0, 1]}),
    "Dust": (
        vm.Dust,
        {"density": "1e-18 * density", "temperature": 20 * u.K, "opacity": vm.Opacity(**KAPPA)},
    ),
    "Expression": (vm.Expression, {"source": "a"}),
    "FreeFree": (vm.FreeFree, {"electrons": "density / (1 g)", "temperature": 1e4 * u.K}),
    "Gaussian": (vm.Gaussian, {**WITH, "center": 0.3, "sigma": 0.1, "color": 1.0}),
    "Image": (vm.Image, {"intensity": np.ones((2, 2, 3))}),
    "Labels": (vm.Labels, {"expr": "a", "numbers": [1, 2]}),
    "Isosurface": (vm.Isosurface, {"expr": "a", "level": 0.3}),
    "Lines": (vm.Lines, {**GAS, "temperature": 20 * u.K}),
    "Molecule": (vm.Molecule, CO),
    "OctreeGrid": (vm.OctreeGrid, {**{axis: [0, 1, 2] for axis in "xyz"}, "refined": None}),
    "Opacity": (vm.Opacity, KAPPA),
    "Opacity.power_law": (vm.Opacity.power_law, {"kappa": 1, "wavelength": 1000, "beta": 1.5}),
    "Opacity.published": (vm.Opacity.published, {"name": "draine-2003"}),
    "Opacity.from_table": (
        vm.Opacity.from_table,
        {"table": {"wavelength": [1, 2], "kappa": [1, 1]}},
    ),
    "Orthographic": (vm.Orthographic, {"resolution": 2}),
    "Orthographic.framing": (vm.Orthographic.framing, {"volume": VOLUME, "medium": SHELL}),
    "Panorama": (vm.Panorama, {"position": (3, 0, 0), "target": (0, 0, 0), "resolution": 4}),
    "PatchGrid": (vm.PatchGrid, {"lower": [[0, 0, 0]], "upper": [[1, 1, 1]], "shape": [[2, 2, 2]]}),
    "Perspective": (vm.Perspective, {"position": (3, 0, 0), "target": (0, 0, 0), "resolution": 2}),
    "Perspective.framing": (vm.Perspective.framing, {"volume": VOLUME, "medium": SHELL}),
    "Rectangle": (vm.Rectangle, {**WITH, "center": 0.3, "half_width": 0.1, "color": 1.0}),
    "Scene": (vm.Scene, {"settings": {"volume": {"model": "sphere"}, "medium": SHELL}}),
    "Spectrum": (vm.Spectrum, {"spectral": [10, 100], "flux": [1, 2]}),
    "Spheres": (vm.Spheres, {"positions": [[0, 0, 0]], "radii": 0.1}),
    "SphericalGrid": (vm.SphericalGrid, {"r": [1, 2]}),
    "Stars": (vm.Stars, {"positions": [[0, 0, 0]], "radii": 0.1}),
    "Table": (
        vm.Table,
        {"expr": "a", "values": [0, 1], "colors": [1, 2], "opacities": [0, 1]},
    ),
    "Volume": (vm.Volume, {"grid": VOLUME.grid, "fields": {"a": np.zeros((4, 4, 4))}}),
    "channels": (vm.channels, {"first": -1, "last": 1, "count": 3}),
    "column": (vm.column, {"volume": VOLUME, "quantity": "a", "camera": CAMERA}),
    "measure": (vm.measure, {"volume": VOLUME, "quantities": "a"}),
    "moments": (vm.moments, {"volume": VOLUME, "quantity": "density", "camera": CAMERA}),
    "observe": (
        vm.observe,
        {"volume": VOLUME, "medium": DUST, "camera": CAMERA, "wavelengths": [100 * u.um]},
    ),
    "orbit": (vm.orbit, {"camera": CAMERA, "frames": 2}),
    "plan": (vm.plan, SCENE),
    "probe": (vm.probe, {**SCENE, "pixel": (1, 1)}),
    "project": (vm.project, {"volume": VOLUME, "quantity": "a", "camera": CAMERA}),
    "render": (vm.render, SCENE),
    "spectrum": (
        vm.spectrum,
        {"volume": VOLUME, "medium": DUST, "wavelengths": [100 * u.um], "distance": 140 * u.pc},
    ),
    "suggest_medium": (vm.suggest_medium, {"volume": VOLUME, "expr": "a"}),
    "tau_surface": (vm.tau_surface, SCENE),
    "plot_row": (vm.plot_row, {"images": [IMAGE]}),
    "regions.Box": (regions.Box, {}),
    "regions.Sphere": (regions.Sphere, {}),
    "regions.HalfSpace": (regions.HalfSpace, {}),
    "regions.Cylinder": (regions.Cylinder, {}),
    "regions.DoubleCone": (regions.DoubleCone, {}),
    "movies.zoom": (vm.movies.zoom, {}),
    "movies.fade": (vm.movies.fade, {}),
    "movies.keyframes": (vm.movies.keyframes, {}),
    "movies.dolly": (vm.movies.dolly, {}),
    "movies.fly": (vm.movies.fly, {}),
}
# Methods of what the calls return: those that take something a user gives.
METHODS = {
    "image": (IMAGE, "to plot plane to_rgb replace on_sky background_replaced"),
    "cube": (CUBE, "to plot moment channel_maps spectrum_at subtract_continuum total convolve"),
    "spectrum": (SPECTRUM, "to plot replace"),
    "volume": (VOLUME, "array crop evaluate field_unit set_unit slice resample unfolded"),
    "molecule": (vm.Molecule(**CO), "line partition_function"),
    "opacity": (vm.Opacity(**KAPPA), "absorption scattering extinction asymmetry"),
    "medium": (SHELL, "calibrated plot replace"),
}
for _label, (_owner, _names) in METHODS.items():
    for _method in _names.split():
        if hasattr(_owner, _method):
            CALLS[f"{_label}.{_method}"] = (getattr(_owner, _method), {})
# Classes of errors, modules, what opens windows, and bases of media.
UNTRIED = {"FileFormatError", "InputError", "UnitsError", "VoluminousError", "Medium"}
UNTRIED |= {"SpectralMedium", "demo", "movie", "open", "view"}
