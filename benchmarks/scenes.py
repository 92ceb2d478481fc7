"""The benchmark scenes in plain NumPy: one definition, from which every renderer is fed.

The volume is the prestellar core n = 28 (r / pc)^-2 cm^-3 in a box of 0.25 pc; the medium is two
Gaussians in log10(n). Lengths are in parsec (3.08572e18 cm) here; `PARSEC` takes them to cm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PARSEC = 3.08572e18  # cm
PIXELS = 400
COLORS = ((0.4, 0.4, 0.8), (0.89, 0.47, 0.06))


@dataclass(frozen=True)
class Scene:
    """A volume, a medium of Gaussians in log10(density) and an orthographic camera."""

    name: str
    colors: tuple[tuple[float, float, float], ...]
    opacity: float
    centers: tuple[float, ...] = (3.5, 4.0)
    sigmas: tuple[float, ...] = (0.05, 0.10)
    path_length: float = 2.5e16  # cm
    width: float = 0.25  # pc, of the box
    frame: float = 0.25  # pc, of the picture
    cells: int = 100
    incl: float = 60.0
    phi: float = 30.0

    def edges(self) -> np.ndarray:
        """Cell edges along each axis, in pc."""
        return np.linspace(-self.width / 2, self.width / 2, self.cells + 1)

    def density(self) -> np.ndarray:
        """Density at the cell centres, cm^-3, float32, index [ix, iy, iz]."""
        edges = self.edges()
        squares = (0.5 * (edges[1:] + edges[:-1])) ** 2
        volume = np.empty((self.cells,) * 3, dtype=np.float32)
        plane = squares[:, None] + squares[None, :]
        # Slice by slice, so that a volume of 512^3 costs no float64 copy of itself.
        for ix, square in enumerate(squares):
            volume[ix] = 28.0 / (square + plane)
        return volume

    def coefficients(self, logn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Emissivity (n, 3) and extinction (n,), per `path_length`, at values of log10(density)."""
        offsets = (np.asarray(logn)[:, None] - np.array(self.centers)) / np.array(self.sigmas)
        gaussians = np.exp(-0.5 * offsets**2)
        return gaussians @ np.array(self.colors), self.opacity * gaussians.sum(axis=1)

    def source(self, logn: np.ndarray) -> np.ndarray:
        """Emissivity over extinction (n, 3): what VTK and yt call the colour."""
        emissivity, extinction = self.coefficients(logn)
        seen = extinction > 0
        ratio = np.zeros_like(emissivity)
        ratio[seen] = emissivity[seen] / extinction[seen, None]
        return ratio

    def view(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors towards the observer and up in the picture."""
        incl, phi = np.radians(self.incl), np.radians(self.phi)
        sin_i, cos_i, sin_p, cos_p = np.sin(incl), np.cos(incl), np.sin(phi), np.cos(phi)
        return (
            np.array([-sin_p * sin_i, -cos_p * sin_i, cos_i]),
            np.array([sin_p * cos_i, cos_p * cos_i, sin_i]),
        )


def scaled(colors: tuple[tuple[float, float, float], ...], factor: float) -> tuple:
    """Colours multiplied by a factor."""
    return tuple(tuple(factor * value for value in color) for color in colors)


# In `core_wide` the whole box is in the picture, and most rays miss it.
# `core` is nearly transparent (optical depth 0.012). `core_opaque` has its emission and absorption
# in the proportion that an 8-bit picture can hold, so that VTK's result can be looked at.
SCENES = {
    "core": Scene("core", COLORS, opacity=0.001),
    "core_wide": Scene("core_wide", COLORS, opacity=0.001, frame=0.4),
    "core_opaque": Scene("core_opaque", scaled(COLORS, 0.3), opacity=0.3),
}
