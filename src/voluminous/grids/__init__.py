"""How a ray walks: one file per grid, one contract (`grids.contract`)."""

from .cartesian import CartesianGrid

__all__ = ["CartesianGrid"]
