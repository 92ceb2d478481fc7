"""What a medium shows as a function of its scalar x (`Medium.profile`): piecewise linear."""

from __future__ import annotations

import numpy as np

from ..digest import digest

# Up to this part of the effective width a cell sees a single value of the profile.
_NARROW = 1e-3


class Profile:
    """Heights h ≥ 0 at increasing nodes, linear in between, zero outside; the greatest is one.

    Parameters
    ----------
    nodes : array, shape (n,)
        Values of x; two equal ones make a jump.
    heights : array, shape (n,)
        The profile there, in any unit.

    Attributes
    ----------
    width : float
        Effective width ∫ h dx / max h; zero if nothing shows.
    key : bytes
        A hash of nodes and heights: what identifies it.
    """

    def __init__(self, nodes: np.ndarray, heights: np.ndarray) -> None:
        peak = float(heights.max())
        self.nodes = np.asarray(nodes, dtype=np.float64)
        self.heights = heights / peak if peak > 0 else np.zeros(len(nodes))
        steps, rises = np.diff(self.nodes), np.diff(self.heights)
        areas = steps * (self.heights[:-1] + 0.5 * rises)
        self._slopes = np.divide(rises, steps, out=np.zeros(len(steps)), where=steps > 0)
        self._areas = np.concatenate([[0.0], np.cumsum(areas)])
        self.width = float(self._areas[-1])
        self.key = digest(np.concatenate([self.nodes, self.heights]))

    def mean(self, x: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Return the mean of the profile from x - reach to x + reach; zero where x is NaN.

        A shell that is thinner than a cell is seen by the cells it goes through, whether or not it
        meets their centres.
        """
        out = np.zeros(x.shape)
        near = (x + reach >= self.nodes[0]) & (x - reach <= self.nodes[-1])
        x, reach = x[near].astype(np.float64), reach[near].astype(np.float64)
        wide = reach > _NARROW * self.width
        found = np.interp(x, self.nodes, self.heights)
        half = np.where(wide, reach, 1.0)  # twice as much may be no number
        means = 0.5 * (self._integral(x + reach) - self._integral(x - reach)) / half
        out[near] = np.where(wide, means, found)
        return out

    def _integral(self, x: np.ndarray) -> np.ndarray:
        x = np.clip(x, self.nodes[0], self.nodes[-1])
        k = np.clip(np.searchsorted(self.nodes, x, "right") - 1, 0, len(self.nodes) - 2)
        d = x - self.nodes[k]
        return self._areas[k] + d * (self.heights[k] + 0.5 * self._slopes[k] * d)
