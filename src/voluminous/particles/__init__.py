"""Particles on grids: SPH, moving meshes and N-body, deposited so that nothing is lost."""

from .api import deposit, from_particles
from .deposit import Deposit
from .inputs import Particles, particles
from .kernels import KERNELS, Kernel, get_kernel

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
