"""Measurements: what the same integral along rays says of mass, momentum, energy and columns."""

from .columns import column
from .extremes import Extreme, extreme, first_hit
from .probing import Probe, probe
from .surface import TauSurface, tau_surface
from .totals import Measurement, measure
from .velocities import Moments, moments

__all__ = [
    "Extreme",
    "Measurement",
    "Moments",
    "Probe",
    "TauSurface",
    "column",
    "extreme",
    "first_hit",
    "measure",
    "moments",
    "probe",
    "tau_surface",
]
