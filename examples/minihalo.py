"""A collapsing minihalo: two shells of density, the denser one in purple, the other in ochre.

python examples/minihalo.py [moving7_0010] [pixels]

Without a snapshot (of Enzo; reading it needs yt) a halo is made: a steep, oblate cloud, dented by
what falls in.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import voluminous as vm

OCHRE, PURPLE = (0.80, 0.42, 0.07), (0.80, 0.36, 1.6)
RADIUS = 0.36  # kpc, of the outer shell


def snapshot(path: Path) -> vm.Volume:
    """Return the density of all patches, in g / cm3; lengths in kpc."""
    return vm.open(path, ["density"], unit="kpc")


def stand_in() -> vm.Volume:
    """Return an oblate cloud on an octree, finer towards its middle, much like the snapshot."""

    def near(x, y, z, size):
        return np.hypot(np.hypot(x, y), z) < 5 * size

    walls = np.linspace(-3, 3, 9)
    volume = vm.Volume(vm.OctreeGrid.from_function(walls, walls, walls, near, 3, unit="kpc"))
    volume["d"] = "sqrt(x**2 + y**2 + 1.4 * z**2)"
    volume["dents"] = "sin(9 * x + 4 * z) * sin(8 * y - 1) * cos(7 * z + 5 * y)"
    volume["density"] = "10**(-22.0 - 2.3 * log10(d / 0.32) + 0.12 * dents)"
    return volume


def shells() -> vm.Medium:
    """Return both shells: as bright as 0.1 and 0.3 of a wall that hides what is behind it."""
    outer = vm.Gaussian("log10(density)", -22.0, 0.03, OCHRE, 0.1, path_length="auto")
    inner = vm.Gaussian("log10(density)", -21.3, 0.03, PURPLE, 0.3, path_length="auto")
    return outer + inner


def camera(volume: vm.Volume, pixels: int = 400) -> vm.Orthographic:
    """Return a camera that looks at the middle of the outer shell."""
    volumes = np.where(volume.array("density") > 1e-22, volume.grid.cell_volumes, 0.0).reshape(-1)
    middle = volume.grid.cell_centers() @ volumes / volumes.sum()
    return vm.Orthographic(70, 60, width=2.4 * RADIUS, center=middle, resolution=pixels)


def main() -> None:
    """Save the picture."""
    numbers = [int(word) for word in sys.argv[1:] if word.isdecimal()]
    paths = [Path(word) for word in sys.argv[1:] if not word.isdecimal()]
    volume = snapshot(paths[0]) if paths else stand_in()
    vm.render(volume, shells(), camera(volume, *numbers)).save("minihalo.png")
    print("minihalo.png")


if __name__ == "__main__":
    main()
