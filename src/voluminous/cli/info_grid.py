"""What `voluminous info` tells of a grid, of any kind."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..fields import is_angle
from ..geometry import span


def describe_grid(grid: Any, particles: int | None = None) -> Iterator[str]:
    """Yield lines about a grid: kind, cells, levels, extent, effective resolution.

    Parameters
    ----------
    grid : grid
    particles : int, optional
        Around how many particles it was made: cells and levels are not those of a file then.
    """
    told = grid.describe()
    refined = not grid.is_structured and "base" in told
    yield f"grid: {told['type']}, {_times(grid.shape)} cells{_kind(told)}"
    if particles is not None:
        yield f"  made by voluminous around {particles} particles, which have no cells of their own"
    yield from _extent(grid, told["unit"])
    if refined:
        yield from _levels(grid, told)


def _kind(told: dict[str, Any]) -> str:
    kind = {True: ", uniform", False: ", not uniform"}.get(told.get("uniform", ""), "")
    base = f", base {_times(told['base'])}" if "base" in told else ""
    return kind + base + (", mirrored at the midplane" if told.get("mirror") else "")


def _extent(grid: Any, unit: str) -> Iterator[str]:
    own = tuple(grid.coordinates)
    if own != ("x", "y", "z"):
        for name, edges in zip(own, grid.edges, strict=True):
            own_unit = "rad" if is_angle(name) else unit
            yield f"  {name}  {span(edges[0], edges[-1])} {own_unit}".rstrip()
    for axis, (low, high) in zip("xyz", grid.bounds, strict=True):
        if own == ("x", "y", "z") or axis not in own:
            yield f"  {axis}  {span(low, high)} {unit}".rstrip()


def _levels(grid: Any, told: dict[str, Any]) -> Iterator[str]:
    """Yield the number of cells of each level, their widths, and what they amount to."""
    levels = np.reshape(grid.levels, -1)
    for level, count in enumerate(np.bincount(levels).tolist()):
        if count:
            widths = _widths(grid, levels, level)
            size = " x ".join(f"{w:.4g}" for w in widths)
            yield f"  level {level}: {count} cells of {size} {told['unit']}".rstrip()
    yield f"  effective resolution: {_times(_finest_across(grid, told['base'], levels))}"
    hidden = told.get("hidden_cells", 0)
    if hidden:
        yield f"  {hidden} more cells, under finer ones, are left out, here and in what follows"


def _finest_across(grid: Any, base: Any, levels: np.ndarray) -> np.ndarray:
    """Return how many cells of the finest level fit along each of the grid's own axes.

    They are counted, not measured: base cells and angles need not be evenly wide.
    """
    first = int(np.argmax(levels == levels.max()))
    _, size = grid.boxes(first, first + 1)  # in the units that `divisions` counts
    return np.asarray(base) * grid.divisions // size[:, 0]


def _widths(grid: Any, levels: np.ndarray, level: int) -> np.ndarray:
    first = int(np.argmax(levels == level))
    return np.asarray(grid.cell_sizes(first, first + 1)[:, 0])


def _times(counts: Any) -> str:
    return " x ".join(str(n) for n in counts)
