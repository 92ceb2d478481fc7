"""From where a volume is seen."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry import turns

# Cosines that differ by less are alike: what rounding does to them, and far less than is seen.
_ALIKE = 1e-9


class Sight:
    """Lines of sight of a camera, None if none is known, through the cells of a grid."""

    def __init__(self, grid: Any, camera: Any = None) -> None:
        self.grid, self.camera = grid, camera

    def directions(self, first: int, last: int) -> np.ndarray:
        """Return unit vectors from the observer to the centres of cells, shape (3, n).

        Raises
        ------
        InputError
            If no camera is known or it cannot tell, or a cell is seen in more than one direction.
        """
        if self.camera is None:
            raise InputError(
                "los(...) needs to know from where the volume is seen; "
                "give a camera: volume.evaluate(..., camera=camera)"
            )
        if self.grid.mirror:
            raise InputError(
                "los(...) differs between a cell and its mirror image: volume.unfolded() has both"
            )
        if getattr(self.camera, "parallel", False) and not turns(self.grid):
            # Where cells are would take ten times as long as all else.
            return np.broadcast_to(self._to(np.zeros((3, 1))), (3, last - first))
        centers = self.grid.cell_centers(first, last)
        found = self._to(centers)
        self._check_around(centers, found)
        return found

    def _check_around(self, centers: np.ndarray, found: np.ndarray) -> None:
        """Refuse cells that go around the axis, or the centre, and look different from there.

        Seen from the axis, or along it, they look the same on all sides, whichever way they move.
        """
        for turn in turns(self.grid):
            if not np.allclose(self._to(turn @ centers), turn @ found, rtol=0, atol=_ALIKE):
                raise InputError(
                    "los(...) differs along a cell that goes all around: volume.unfolded(phi=64) "
                    "has many in its place, which tell directions apart (where a grid is refined, "
                    "volume.resample(grid) onto one that is not); "
                    "components in the grid's own coordinates keep their values"
                )

    def key(self) -> bytes | None:
        """Return what lines of sight depend on: those to the corners of the domain tell."""
        if self.camera is None:
            return None
        corners = np.array(np.meshgrid(*self.grid.bounds, indexing="ij")).reshape(3, -1)
        return self._to(corners).tobytes()

    def _to(self, points: np.ndarray) -> np.ndarray:
        return np.asarray(self.camera.lines_of_sight(points, self.grid))
