"""How a ray walks: one folder per family of grids, one contract (`grids.contract`)."""

from .cartesian.grid import CartesianGrid
from .curvilinear.cylindrical import CylindricalGrid
from .curvilinear.spherical import SphericalGrid
from .trees.octree import OctreeGrid
from .trees.patches import PatchGrid

__all__ = ["CartesianGrid", "CylindricalGrid", "OctreeGrid", "PatchGrid", "SphericalGrid"]
