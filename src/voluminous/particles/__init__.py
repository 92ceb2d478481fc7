"""Particles on grids: SPH, moving meshes and N-body, deposited so that nothing is lost."""

from .api import deposit, from_particles
from .deposit import Deposit
from .inputs import KERNELS, Kernel, Particles, get_kernel, particles

__all__ = [
    "KERNELS",
    "Deposit",
    "Kernel",
    "Particles",
    "deposit",
    "from_particles",
    "get_kernel",
    "particles",
]
