"""Fields on other cells: onto another grid, onto a plane, into a table."""

from .cut import Slice
from .methods import OnOtherCells
from .plane import Plane

__all__ = ["OnOtherCells", "Plane", "Slice"]
