"""Measurements: what the same integral along rays says of mass, momentum, energy and columns."""

from .column import column
from .extremes import Extreme, extreme, first_hit
from .moments import Moments, moments
from .surface import TauSurface, tau_surface

__all__ = [
    "Extreme",
    "Moments",
    "TauSurface",
    "column",
    "extreme",
    "first_hit",
    "moments",
    "tau_surface",
]
