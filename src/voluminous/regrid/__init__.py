"""Fields on other cells: onto another grid, onto a plane, into a table."""

from .methods import OnOtherCells
from .slices import Plane, Slice

__all__ = ["OnOtherCells", "Plane", "Slice"]
