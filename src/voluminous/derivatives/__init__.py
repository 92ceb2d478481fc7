"""Fields made of fields: what ``gradmag``, ``grad``, ``los`` … in expressions stand for."""

from .cell_slopes import CellSlopes
from .differentiated import differences
from .fields import Derivatives
from .neighbours import Cells
from .on_trees import BoxesOfTree
from .sight import Sight
from .vectors import component, component_of_cells, is_component

__all__ = [
    "BoxesOfTree",
    "CellSlopes",
    "Cells",
    "Derivatives",
    "Sight",
    "component",
    "component_of_cells",
    "differences",
    "is_component",
]
