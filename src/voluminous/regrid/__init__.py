"""Fields on other cells: onto another grid, onto a plane, into a table."""

from .slices import Plane, Slice

__all__ = ["Plane", "Slice"]
