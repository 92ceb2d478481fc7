"""A slow, plain NumPy volume renderer, written to be obviously correct.

It shares no code with the package that it tests. See `render`.
"""

from .camera import Camera, Rays
from .schemes import (
    solve_first_order,
    solve_first_order_radmc,
    solve_olson_kunasz,
    solve_second_order,
)
from .tracing import SCHEMES, flux_conserving_samples, render
from .traverse import Segments, segments
from .vertices import interpolate, vertex_means

__all__ = [
    "SCHEMES",
    "Camera",
    "Rays",
    "Segments",
    "flux_conserving_samples",
    "interpolate",
    "render",
    "segments",
    "solve_first_order",
    "solve_first_order_radmc",
    "solve_olson_kunasz",
    "solve_second_order",
    "vertex_means",
]
