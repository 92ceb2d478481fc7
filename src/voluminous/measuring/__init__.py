"""Measurements: what the same integral along rays says of mass, momentum, energy and columns."""

from ..errors import immutable
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

for _result in (Extreme, Measurement, Moments, Probe, TauSurface):
    immutable(_result, "its images and quantities are converted by their own .to(unit)")
