"""Measurements: what the same integral along rays says of mass, momentum, energy and columns."""

from ..errors import immutable
from .columns import column
from .probing import Probe, probe
from .projections import project
from .surface import TauSurface, tau_surface
from .totals import Measurement, measure
from .velocities import Moments, moments

__all__ = [
    "Measurement",
    "Moments",
    "Probe",
    "TauSurface",
    "column",
    "measure",
    "moments",
    "probe",
    "project",
    "tau_surface",
]

for _result in (Measurement, Moments, Probe, TauSurface):
    immutable(_result, "its images and quantities are converted by their own .to(unit)")
