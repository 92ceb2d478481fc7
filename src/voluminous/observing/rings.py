"""`Rings`: a camera whose pixels are sectors of rings, for fluxes within circles."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr, from_host
from ..backend.types import Float
from ..cameras import Orthographic
from ..cameras.contract import Frame
from ..errors import InputError
from ..grids.contract import Ray

if TYPE_CHECKING:
    from ..grids.contract import Grid


class Rings(Orthographic):
    """Parallel rays on rings in the image plane, each through the middle of a sector.

    The picture has a column for each azimuth, from image x towards y, and a row for each ring, the
    innermost first. Parts of a pixel (``antialias``) have equal areas.

    Parameters
    ----------
    walls : array_like, shape (n + 1,)
        Radii that bound the rings, rising, from 0 or more, in the grid's unit.
    radii : array_like, shape (n,), optional
        Where rays are. Default: half of a ring's area is within.
    azimuths : int
        Number of sectors of a ring.
    incl, phi, posang, center
        As for `Orthographic`.
    """

    def __init__(
        self,
        walls: Any,
        radii: Any = None,
        azimuths: int = 128,
        incl: Any = 0.0,
        phi: Any = 0.0,
        posang: Any = 0.0,
        center: Any = None,
    ) -> None:
        walls = np.asarray(walls, np.float64)
        super().__init__(incl, phi, posang, resolution=(azimuths, len(walls) - 1), center=center)
        # Squared radii of walls, and of rays between them: areas are linear in these.
        self.squares = np.empty(2 * len(walls) - 1)
        self.squares[::2] = walls**2
        middle = 0.5 * (walls[1:] ** 2 + walls[:-1] ** 2)
        self.squares[1::2] = middle if radii is None else np.square(radii)

    @property
    def areas(self) -> np.ndarray:
        """Area of a pixel of each ring, shape (n, 1), in the grid's unit squared."""
        return np.asarray(np.pi / self.resolution[0] * np.diff(self.squares[::2])[:, None])

    def finer(self) -> Rings:
        """Return rings of half the area with twice the azimuths."""
        walls = self.squares[::2]
        halves = np.sort(np.concatenate([walls, 0.5 * (walls[1:] + walls[:-1])]))
        azimuths = 2 * self.resolution[0]
        return self.replace(walls=np.sqrt(halves), radii=None, azimuths=azimuths)

    def flat(self) -> Orthographic:
        """Return a camera with the same orientation and middle, and ordinary pixels."""
        return Orthographic(self.incl, self.phi, self.posang, center=self.center)

    def frame(self, grid: Grid) -> Frame:
        count = float(self.resolution[1])
        outer = [float(np.sqrt(self.squares[-1])), 0.0, 0.0]
        vectors = np.vstack([super().frame(grid).vectors, outer])
        return Frame(self.resolution, (2.0 * np.pi, count), (np.pi, 0.5 * count), vectors)

    def rays(self, vectors: list[list[Float]], u: Float, v: Float) -> Ray:
        *plane, (outer, _, _) = vectors
        real, last = type(u), len(self.squares) - 2
        table = from_host(real, self.squares / self.squares[-1])  # no unit overflows
        below = dr.clip(dr.floor(2.0 * v), 0.0, last)
        number = dr.uint32_array_t(real)(below)
        first, second = (dr.gather(real, table, number + k) for k in (0, 1))
        radius = outer * dr.sqrt(dr.lerp(first, second, 2.0 * v - below))
        sine, cosine = dr.sincos(u)
        return super().rays(plane, radius * cosine, radius * sine)

    @property
    def straight(self) -> bool:
        return False

    def key(self) -> Hashable:
        return None  # `rays` has a table of its own

    def project(self, points: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        raise InputError("objects are not drawn on rings; vm.spectrum adds the flux of stars")
