"""Inside a disc: a protoplanetary disc on a spherical grid, seen from outside and from within.

python examples/disc.py [cells] [pixels]

The radii are logarithmic, the polar angles close together near the midplane, and the innermost
radius is zero: there is the star. A planet has opened a gap and stirs up two spiral arms.
"""

from __future__ import annotations

import sys

import numpy as np

import voluminous as vm

# What a unit of density emits and absorbs in red, green and blue: the dust is redder near the star,
# where it is warmer, and takes away more of the blue light.
GLOW = ((0.95, 1.0), (0.75, 0.65), (0.7, 0.35))
ABSORPTION = (3.0, 4.0, 5.2)
STAR = (10.0, 9.0, 7.0)


def edges(cells: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the walls of the cells along r (au), theta and phi."""
    r = np.concatenate([[0.0], np.geomspace(1, 100, cells)])
    stretched = np.sinh(np.linspace(-4.5, 4.5, 2 * (cells // 2) + 1)) / np.sinh(4.5)
    return r, 0.5 * np.pi * (1 + stretched), np.linspace(0, 2 * np.pi, 2 * cells + 1)


def disc(cells: int = 96) -> vm.Volume:
    """Return the disc: its density is all that rays need."""
    volume = vm.Volume(vm.SphericalGrid(*edges(cells), unit="au"))
    volume["R"] = "r * sin(theta) / (1 au)"  # a plain number, as in the formulas below
    volume["height"] = "0.06 * (R / 30)**0.3"  # scale height over radius
    volume["turn"] = "phi - 1 - log(R / 35) / 0.28"  # angle from the arms, which are logarithmic
    volume["arms"] = "0.25 + 5 * exp(8 * (cos(2 * turn) - 1) - log(R / 35)**2 / 1.5)"
    volume["gap"] = "1 - 0.99 * exp(-((R - 35) / 6)**4)"
    volume["surface"] = "arms * gap / R * exp(-(R / 80)**8 - (3 / R)**6)"
    planet = "0.04 * exp(-0.5 * ((x - 18.9)**2 + (y - 29.5)**2 + z**2) / 1.2**2)"
    volume["density"] = f"surface / (height * R) * exp(-0.5 * (z / R / height)**2) + {planet}"
    return volume


def medium() -> vm.Medium:
    """Return dust that glows and absorbs, and the star."""
    emission = [
        f"4 * density * {color} * (30 / (r + 3))**{slope} + {star} * exp(-(r / 0.9)**2)"
        for (color, slope), star in zip(GLOW, STAR, strict=True)
    ]
    return vm.Coefficients(emission, [f"{kappa} * density" for kappa in ABSORPTION])


def cameras(pixels: int = 480) -> dict[str, vm.Perspective]:
    """Return three observers: one outside, two in the disc."""
    size = (pixels, pixels * 9 // 16)
    return {
        "outside": vm.Perspective((0, -150, 95), (0, -8, 0), 50, resolution=size),
        "between": vm.Perspective((-50, 0, 7), (0, 0, 1), 90, resolution=size),
        "planet": vm.Perspective((24, 46, 4), (12, 0, -1), 75, resolution=size),
    }


def main() -> None:
    """Save all pictures."""
    cells, pixels = (int(word) for word in (*sys.argv[1:], "96", "480")[:2])
    volume, dust = disc(cells), medium()
    for name, camera in cameras(pixels).items():
        image = vm.render(volume, dust, camera)
        image.save(f"disc_{name}.png", stretch="asinh", exposure=0.8)
        print(f"disc_{name}.png")


if __name__ == "__main__":
    main()
