"""A zoom through twenty levels: surfaces of density around a point, from 1 down to a millionth.

python examples/zoom.py [pixels]

The octree is split around a point, each time into eight, twenty times over: its finest cells are
8 million times smaller than the domain. The density falls with the square of the distance, with
lobes that turn with its logarithm, so that there is something to see at every scale.
"""

from __future__ import annotations

import sys

import numpy as np

import voluminous as vm

POINT = np.array([1 / 3, 0.2, 1 / 7])
TOWARDS = np.array([-0.4, -0.8, 0.45])  # to the observer
WIDTHS = (2.0, 2e-2, 2e-4, 6e-6)
COLORS = ("#e8734a", "#f2c14e", "#5fb49c", "#4a8fd3", "#a678c9")


def tree(levels: int = 20, cells: float = 8) -> vm.OctreeGrid:
    """Return a grid whose cells around the point are about as wide as their distance / `cells`."""

    def near(x, y, z, size):
        return np.linalg.norm([x - POINT[0], y - POINT[1], z - POINT[2]], axis=0) < cells * size

    walls = np.linspace(-1, 1, 9)
    return vm.OctreeGrid.from_function(walls, walls, walls, near, levels)


def matter(grid: vm.OctreeGrid) -> vm.Volume:
    """Return the logarithm of the density in all cells."""
    volume = vm.Volume(grid)
    for name, axis, place in zip(("a", "b", "c"), "xyz", POINT.tolist(), strict=True):
        volume[name] = f"{axis} - {place!r}"
    volume["d"] = "sqrt(a**2 + b**2 + c**2)"
    volume["turn"] = "log(d)"
    lobes = "sin(3 * a / d + 2.1 * turn) * sin(3 * b / d - 1.3 * turn)"
    lobes += " + sin(4 * c / d + 0.7 * turn) * cos(3 * a / d + 1.1 * turn)"
    volume["logn"] = f"-2 * log10(d) + 0.35 * ({lobes})"
    for name in ("d", "turn"):
        del volume[name]
    return volume


def medium() -> vm.Medium:
    """Return surfaces of density, open towards the observer."""
    levels = np.arange(0.5, 12.6, 0.5)
    colors = [[int(COLORS[k % 5][i : i + 2], 16) / 255 for i in (1, 3, 5)] for k in range(25)]
    behind = " + ".join(f"{n} * {w}" for n, w in zip("abc", TOWARDS.tolist(), strict=True))
    return vm.Isosurface(
        "logn", level=levels, color=colors, opacity=1, shading=0.9, where=f"{behind} < 0"
    )


def cameras(pixels: int = 400) -> list[vm.Orthographic]:
    """Return one camera per magnification."""
    return [
        vm.Orthographic.looking(-TOWARDS, (0, 0, 1), width=w, center=POINT, resolution=pixels)
        for w in WIDTHS
    ]


def main() -> None:
    """Save all pictures."""
    volume, surfaces = matter(tree()), medium()
    for camera in cameras(*map(int, sys.argv[1:2])):
        name = f"zoom_{float(camera.width):g}.png"
        vm.render(volume, surfaces, camera, samples=2).save(name, exposure=1)
        print(name)


if __name__ == "__main__":
    main()
