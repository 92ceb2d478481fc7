"""Make the file of the class: a cloud that collapses to a star with a disc and two jets.

python docs/class_protostar.py [protostar.h5]

Not a simulation: closed forms, on the octree that a simulation would refine towards the star.
"""

from __future__ import annotations

import sys

import astropy.units as u
import numpy as np

import voluminous as vm

AU, SUN, GRAVITY = 1.496e13, 1.989e33, 6.674e-8  # CGS
HALF = 3200.0  # au, half the side of the box


def refined(x, y, z, size):
    """Refine towards the star, the disc, and the walls of the cavities."""
    r, height = np.hypot(x, y), np.abs(z)
    distance = np.hypot(r, z)
    wall = np.abs(r - cavity(height)) < 0.5 * size
    return (distance < 4 * size) | ((height < size) & (distance < 7 * size)) | (wall & (size > 120))


def cavity(height):
    """Return the radius of the jets' walls at a height, in au: parabolas."""
    return 6.0 * np.sqrt(height + 1.0)


def protostar() -> vm.Volume:
    """Return density in g/cm3, temperature in K, and velocities in km/s; lengths in au."""
    walls = np.linspace(-HALF, HALF, 17)
    volume = vm.Volume(vm.OctreeGrid.from_function(walls, walls, walls, refined, 5, unit="au"))
    x, y, z = volume.grid.cell_centers()
    r, height = np.hypot(x, y), np.abs(z)
    distance = np.hypot(r, z)

    # The cloud falls freely (r^-1.5); the disc is in hydrostatic balance, with two spiral arms.
    cloud = 4e-18 * ((distance + 60) / 1000) ** -1.5 * (0.5 + (r + 30) / (distance + 30))
    scale = 0.12 * r**1.15 + 5
    arms = 1 + 0.7 * np.cos(2 * np.arctan2(y, x) + 6 * np.log(r + 20))
    disc = 4e-14 * (r / 50 + 0.4) ** -2 * arms * np.exp(-((r / 350) ** 4) - (z / scale) ** 2 / 2)
    jet = (r < cavity(height)) & (height > 2 * scale)
    ripples = 1 + 0.5 * np.sin(height / 130) * np.cos(3 * np.arctan2(y, x))
    density = np.where(jet, 3e-20 * ripples / (height / 1000 + 0.3), cloud + disc)
    temperature = 14 + 120 * (distance / 60 + 0.4) ** -0.5 + np.where(jet, 150, 0)

    # Rotation about z, Kepler's in the disc; infall outside it; the jets leave at 40 km/s.
    kepler = np.sqrt(GRAVITY * 0.8 * SUN / ((distance + 20) * AU)) / 1e5
    flat = np.exp(-((z / (2 * scale)) ** 2))
    turning = kepler * np.where(jet, 0.2, 0.3 + 0.7 * flat)
    falling = np.where(jet, 0, -0.9 * kepler * (1 - flat)) / distance
    fields = {
        "density": density * u.g / u.cm**3,
        "temperature": temperature * u.K,
        "velocity_x": (falling * x - turning * y / (r + 1)) * u.km / u.s,
        "velocity_y": (falling * y + turning * x / (r + 1)) * u.km / u.s,
        "velocity_z": (falling * z + np.where(jet, 40 * np.sign(z), 0)) * u.km / u.s,
    }
    for name, values in fields.items():
        volume[name] = values.astype(np.float32)
    return volume


if __name__ == "__main__":
    path = sys.argv[1] if len(sys.argv) > 1 else "examples/protostar.h5"
    protostar().save(path, compress=True)
    print(path)
