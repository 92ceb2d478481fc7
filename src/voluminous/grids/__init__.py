"""How a ray walks: one file per grid, one contract (`grids.contract`)."""

from .cartesian import CartesianGrid
from .cylindrical import CylindricalGrid
from .octree import OctreeGrid
from .patches import PatchGrid
from .spherical import SphericalGrid

__all__ = ["CartesianGrid", "CylindricalGrid", "OctreeGrid", "PatchGrid", "SphericalGrid"]
