"""Fields made of fields: what ``gradmag``, ``grad``, ``los`` … in expressions stand for."""

from .fields import Derivatives, differences
from .neighbours import NeighbourDifferences
from .tree_slopes import BoxesOfTree, CellSlopes
from .vectors import LinesOfSight, component, component_of_cells, is_component

__all__ = [
    "BoxesOfTree",
    "CellSlopes",
    "Derivatives",
    "LinesOfSight",
    "NeighbourDifferences",
    "component",
    "component_of_cells",
    "differences",
    "is_component",
]
