"""From where a volume is seen."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError


class Sight:
    """Lines of sight of a camera, None if none is known, through the cells of a grid."""

    def __init__(self, grid: Any, camera: Any = None) -> None:
        self.grid, self.camera = grid, camera

    def directions(self, first: int, last: int) -> np.ndarray:
        """Return unit vectors from the observer to the centres of cells, shape (3, n).

        Raises
        ------
        InputError
            If no camera is known or it cannot tell, or a cell is in two places.
        """
        if self.camera is None:
            raise InputError(
                "los(...) needs to know from where the volume is seen; "
                "give a camera: volume.evaluate(..., camera=camera)"
            )
        if getattr(self.grid, "mirror", False):
            raise InputError(
                "los(...) differs between a cell and its mirror image: volume.unfolded() has both"
            )
        return self._to(self.grid.cell_centers(first, last))

    def key(self) -> bytes | None:
        """Return what lines of sight depend on: those to the corners of the domain tell."""
        if self.camera is None:
            return None
        corners = np.array(np.meshgrid(*self.grid.bounds, indexing="ij")).reshape(3, -1)
        return self._to(corners).tobytes()

    def _to(self, points: np.ndarray) -> np.ndarray:
        return np.asarray(self.camera.lines_of_sight(points, self.grid))
