"""An outflow that is driven by ionisation: the front, the dense gas around it, and the star.

python examples/outflow.py [output_00003] [pixels]

Without a snapshot (of RAMSES; reading it needs yt) a bubble is made that breaks out of a disc. The
star is seen in front of everything, in a channel of its own.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import voluminous as vm

RED, BLUE, PALE = (1.0, 0.33, 0.2), (0.1, 0.3, 0.8), (0.45, 0.6, 1.0)
STAR = (0.5, 0.5, 0.5)  # pc


def snapshot(path: Path) -> vm.Volume:
    """Return density (g / cm3) and ionised fraction of the leaves; lengths in pc."""
    return vm.open(path, {"density": "density", "ionised": "hydro_scalar_00"})


def stand_in(cells: int = 64) -> vm.Volume:
    """Return a bubble that is longer along the axis of a tilted disc, and has swept up its gas."""
    volume = vm.Volume(vm.CartesianGrid.uniform(cells, (0.3, 0.7), unit="pc"))
    c, s = np.cos(np.radians(25)).item(), np.sin(np.radians(25)).item()
    volume["up"] = f"{c} * (z - 0.5) + {s} * (y - 0.5)"
    volume["out"] = f"sqrt((x - 0.5)**2 + ({c} * (y - 0.5) - {s} * (z - 0.5))**2)"
    volume["bubble"] = "sqrt((out / 0.055)**2 + (up / 0.085)**2)"  # 1 at its surface
    volume["ionised"] = "1 / (1 + exp((bubble - 1) / 0.02))"
    disc = "10**(-18.3 - 0.5 * (up / 0.03)**2 - (out / 0.16)**2)"
    swept = "10**(-19.3 - 0.5 * ((bubble - 1.2) / 0.06)**2)"
    volume["density"] = f"(1 - 0.999 * ionised) * ({disc} + {swept})"
    return volume


def medium() -> vm.Medium:
    """Return the ionisation front, and two shells of dense gas."""
    front = vm.Gaussian("ionised", 0.5, 0.1, RED, 0.15, path_length="auto")
    wide = vm.Gaussian("log10(density)", -18.9, 0.04, BLUE, 0.1, path_length="auto")
    dense = vm.Gaussian("log10(density)", -18.4, 0.05, PALE, 0.15, path_length="auto")
    return front + wide + dense


def star() -> vm.Stars:
    """Return the star: a small disc in the fourth channel, which pictures show as white."""
    return vm.Stars([STAR], 1.0, radii=0.0025, depth="foreground", channel=3, relative=True)


def camera(pixels: int = 400) -> vm.Orthographic:
    """Return a camera that sees the outflow from the side."""
    return vm.Orthographic(65, 150, width=0.25, center=STAR, resolution=pixels)


def main() -> None:
    """Save the picture."""
    numbers = [int(word) for word in sys.argv[1:] if word.isdecimal()]
    paths = [Path(word) for word in sys.argv[1:] if not word.isdecimal()]
    volume = snapshot(paths[0]) if paths else stand_in()
    image = vm.render(volume, medium(), camera(*numbers), objects=[star()])
    image.save("outflow.png")
    print("outflow.png")


if __name__ == "__main__":
    main()
