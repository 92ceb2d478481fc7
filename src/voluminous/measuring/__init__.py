"""Measurements: what the same integral along rays says of mass, momentum, energy and columns."""

from .columns import column
from .extremes import Extreme, extreme, first_hit
from .surface import TauSurface, tau_surface
from .totals import Measurement, measure
from .velocities import Moments, moments

__all__ = [
    "Extreme",
    "Measurement",
    "Moments",
    "TauSurface",
    "column",
    "extreme",
    "first_hit",
    "measure",
    "moments",
    "tau_surface",
]
