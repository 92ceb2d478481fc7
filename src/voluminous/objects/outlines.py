"""Outlines of a grid's levels, as polylines: straight ones, and arcs around its axis."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..geometry import CARTESIAN, position
from .edges import Edges, creases, every_edge, joined
from .lattices import Lattice, lattice_of

# An arc is straight for so long (radian): half of that from its chord, 2e-4 of the radius.
_STRAIGHT = np.pi / 90
# Compared with the size of a domain these are one point.
_POINT = 1e-12


def outline(grid: Any, level: int, merged: bool) -> list[np.ndarray]:
    """Return polylines around what is refined `level` times: arrays of shape (lines, n, 3).

    Parameters
    ----------
    grid : Grid
    level : int
        0 is the domain.
    merged : bool
        Around all that is refined, as one body; else around each box.

    Returns
    -------
    list of arrays
        One for each number of points n.
    """
    lattice = lattice_of(grid, level)
    if merged or lattice.boxes is None:
        edges = creases(lattice.block, lattice.period, lattice.seams)
        start, stop = edges.start * lattice.size, edges.stop * lattice.size[edges.axis]
        edges = Edges(edges.axis, start, stop, edges.seam)
    else:
        edges = _closed(every_edge(*lattice.boxes), lattice)
    if lattice.system != CARTESIAN:
        edges = _visible(edges, lattice)
    return _polylines(joined(edges), lattice)


def _closed(edges: Edges, lattice: Lattice) -> Edges:
    for axis, period in enumerate(lattice.period):
        if period:
            across = edges.axis != axis
            edges.start[across, axis] %= period
    return edges


def _visible(edges: Edges, lattice: Lattice) -> Edges:
    first, last = edges.ends()
    ends = [position(lattice.system, lattice.own(place.T)) for place in (first, last)]
    near = _POINT * max(np.abs(end).max(initial=0.0) for end in ends)
    axial = np.all([np.hypot(end[0], end[1]) <= near for end in ends], axis=0)
    phi, away = lattice.system.index("phi"), np.abs(ends[1] - ends[0]).max(axis=0) > near
    # A circle ends where it begins; on the axis it is a point.
    kept = np.where(axial, away & (edges.axis != phi), away | (edges.axis == phi))
    kept &= ~(edges.seam & (axial | _on_planes(edges, lattice)))
    edges.start[axial, phi] = 0
    return edges.some(kept)


def _on_planes(edges: Edges, lattice: Lattice) -> np.ndarray:
    """Return which edges, if they are seams, are on planes: these need no lines to be seen."""
    if "theta" in lattice.system:
        return (edges.axis == 0) & np.isin(edges.start[:, 1], lattice.seams[1])
    return edges.axis == 0


def _polylines(edges: Edges, lattice: Lattice) -> list[np.ndarray]:
    first, last = (lattice.own(place.T) for place in edges.ends())
    turned = np.isin(np.array(lattice.system)[edges.axis], ("theta", "phi"))
    way = np.abs(last - first)[edges.axis, np.arange(len(edges.axis))]
    steps = np.where(turned, np.ceil(way / _STRAIGHT - 1e-6), 1).astype(int)
    found: list[np.ndarray] = []
    for count in np.unique(steps):
        a, b = first[:, steps == count], last[:, steps == count]
        parts = np.linspace(a, b, count + 1)  # points, axes, lines
        own = np.moveaxis(parts, 2, 0).reshape(-1, 3).T
        found.append(position(lattice.system, own).T.reshape(-1, count + 1, 3))
    return found
