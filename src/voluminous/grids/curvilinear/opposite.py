"""Places beyond the axis and the centre: there are the leaves opposite."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import Float, dr, from_host
from .grid import FULL_CIRCLE

if TYPE_CHECKING:
    from ...backend.device import Backend

_HALF = 0.5 * FULL_CIRCLE
# A place outside, along any axis, also where that closes upon itself.
_NOWHERE = -np.inf


class Opposite:
    """Moves places beyond the axis and the centre to where they are.

    Parameters
    ----------
    grid : RefinedCells
    alike : list of bool
        Which axes are angles with one cell; there places are turns of it.
    half : float
        Half a turn of these.
    backend : Backend
        In double precision.
    """

    def __init__(self, grid: Any, alike: list[bool], half: float, backend: Backend) -> None:
        self.real, self.UInt = backend.Float, backend.UInt
        names, edges = list(grid.coordinates), grid.edges
        self.azimuth = names.index("phi")
        self.polar = names.index("theta") if "theta" in names else None
        self.alike, self.half, self.mirrored = alike, half, grid.mirror
        extent = grid.tree.extent
        self.extent = [dr.opaque(backend.Float, float(n)) for n in extent]
        self.centre = edges[0][0] == 0.0
        self.poles = self.polar is not None and not alike[self.polar]
        self.north = self.poles and edges[1][0] == 0.0
        self.south = self.poles and edges[1][-1] == _HALF
        self.around = grid.is_periodic
        self.tables: dict[int, Any] = {}
        if self.around and not alike[self.azimuth] and (self.centre or self.north or self.south):
            fine = grid.fine_edges[self.azimuth]
            turned = np.mod(_middles(fine) + _HALF - fine[0], FULL_CIRCLE) + fine[0]
            self.tables[self.azimuth] = from_host(self.real, _places(fine, turned))
        if self.centre and self.poles and not self.mirrored:
            fine = grid.fine_edges[1]
            self.tables[1] = from_host(self.real, _places(fine, _HALF - _middles(fine)))

    def moved(self, place: list[Float]) -> list[Float]:
        """Return where places are, in finest units."""
        place = list(place)
        if self.north:
            place = self._through_axis(place, place[1] < 0.0, -place[1])
        if self.south:
            end = self.extent[1]
            place = self._through_axis(place, place[1] > end, 2.0 * end - place[1])
        return self._through_centre(place) if self.centre else place

    def _through_axis(self, place: list[Float], beyond: Any, polar: Any) -> list[Float]:
        out = [place[0], dr.select(beyond, polar, place[1]), place[2]]
        out[2] = dr.select(beyond, self._half_turned(place[2]), place[2])
        return out

    def _through_centre(self, place: list[Float]) -> list[Float]:
        beyond, out = place[0] < 0.0, list(place)
        out[0] = dr.abs(place[0])
        out[self.azimuth] = self._half_turned(place[self.azimuth])
        if self.polar is not None:
            out[1] = self._upside_down(place[1])
        return [dr.select(beyond, new, old) for new, old in zip(out, place, strict=True)]

    def _upside_down(self, place: Float) -> Float:
        if self.alike[1]:
            return -place
        return 2.0 * self.extent[1] - place if self.mirrored else self._looked_up(1, place)

    def _half_turned(self, place: Float) -> Float:
        if self.alike[self.azimuth]:
            return place + self.half
        if not self.around:
            return self.real(_NOWHERE)  # a wedge
        extent = self.extent[self.azimuth]
        wrapped = place - extent * dr.floor(place / extent)
        return self._looked_up(self.azimuth, wrapped)

    def _looked_up(self, axis: int, place: Float) -> Float:
        extent = self.extent[axis]
        inside = (place > 0.0) & (place < extent)
        unit = self.UInt(dr.clip(place, 0.0, extent - 0.5))
        return dr.select(inside, dr.gather(self.real, self.tables[axis], unit, inside), _NOWHERE)


def _middles(edges: np.ndarray) -> np.ndarray:
    return 0.5 * (edges[1:] + edges[:-1])


def _places(edges: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return the middles of the cells around coordinates, in units of cells; outside, nowhere."""
    inside = (own > edges[0]) & (own < edges[-1])
    return np.where(inside, np.searchsorted(edges, own, side="right") - 0.5, _NOWHERE)
