"""Measure the order of convergence of every scheme: how the error falls when cells are refined.

The emissivity and the extinction of the scene are smooth functions of the coordinates; what the
picture should be is integrated along each ray in many small steps (Simpson's rule).
"""

from __future__ import annotations

import numpy as np

import voluminous as vm
from voluminous.geometry import image_axes
from voluminous.schemes import SCHEMES

CELLS = (16, 32, 64, 128)
HALF = 1.0
# Rays at odd places within their cells; along the axis these places do not change on the way.
VIEWS = {
    "along z (incl=0)": vm.Orthographic(0, 0, width=1.0, resolution=29, shift=(0.0123, 0.0077)),
    "oblique (incl=52, phi=23)": vm.Orthographic(52, 23, width=1.0, resolution=29),
}
STEPS = 1000


def emissivity(x, y, z):
    return 1 + 0.5 * np.sin(3 * x + 2 * y) * np.cos(2 * z)


def extinction(x, y, z):
    return 2 + np.cos(2 * x - y + 3 * z)


def volume(cells: int) -> vm.Volume:
    grid = vm.CartesianGrid.uniform(cells, (-HALF, HALF))
    x, y, z = np.meshgrid(*grid.centers, indexing="ij")
    return vm.Volume(grid, j=emissivity(x, y, z), a=extinction(x, y, z))


def exact(camera: vm.Orthographic) -> np.ndarray:
    """Return the intensity (ny, nx), by Simpson's rule; its error is below 1e-11."""
    frame = camera.frame(vm.CartesianGrid.uniform(1, (-HALF, HALF)))
    u, v = np.meshgrid(*frame.coordinates())
    right, up, towards = image_axes(camera.incl, camera.phi, camera.posang)
    start, away = u[..., None] * right + v[..., None] * up, -towards
    with np.errstate(divide="ignore"):
        walls = np.stack([(-HALF - start) / away, (HALF - start) / away])
    first, last = walls.min(axis=0).max(axis=-1), walls.max(axis=0).min(axis=-1)
    step = (last - first) / STEPS
    intensity, depth, before = np.zeros_like(u), np.zeros_like(u), None
    for k in range(2 * STEPS + 1):
        point = start + (first + 0.5 * k * step)[..., None] * away
        here = emissivity(*np.moveaxis(point, -1, 0)), extinction(*np.moveaxis(point, -1, 0))
        if k % 2:
            middle = here
        else:
            if before is not None:
                (j0, a0), (j1, a1), (j2, a2) = before, middle, here
                half = depth + step * (5 * a0 + 8 * a1 - a2) / 24
                whole = depth + step * (a0 + 4 * a1 + a2) / 6
                seen = j0 * np.exp(-depth) + 4 * j1 * np.exp(-half) + j2 * np.exp(-whole)
                intensity, depth = intensity + step / 6 * seen, whole
            before = here
    return intensity


def convergence(camera: vm.Orthographic, cells=CELLS) -> dict[str, np.ndarray]:
    """Return the largest error, in units of the largest intensity, for each scheme."""
    medium, truth = vm.Coefficients("j", "a"), exact(camera)
    volumes = [volume(n) for n in cells]
    found = {}
    for scheme in SCHEMES:
        images = [
            vm.render(v, medium, camera, scheme=scheme, precision="double", cutoff=0)
            for v in volumes
        ]
        largest = [np.abs(image.intensity[..., 0] - truth).max() for image in images]
        found[scheme] = np.array(largest) / truth.max()
    return found


if __name__ == "__main__":
    for title, camera in VIEWS.items():
        print(title)
        for scheme, largest in convergence(camera).items():
            slopes = np.log2(largest[:-1] / largest[1:])
            print(f"  {scheme:13}", *(f"{e:.1e}" for e in largest), " slopes", slopes.round(2))
