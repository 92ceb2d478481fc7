"""How a ray walks: one folder per family of grids, one contract (`grids.contract`)."""

from .cartesian.grid import CartesianGrid
from .curvilinear import refined as _refined  # noqa: F401 - tells the plain grids of it
from .curvilinear.grid import CylindricalGrid, SphericalGrid
from .trees.octree import OctreeGrid
from .trees.patches import PatchGrid

__all__ = ["CartesianGrid", "CylindricalGrid", "OctreeGrid", "PatchGrid", "SphericalGrid"]
