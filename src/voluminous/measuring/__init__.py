"""Measurements: columns, projections, moments, totals, surfaces of optical depth, and `probe`."""

from ..errors import immutable
from .columns import column
from .probe_result import Probe
from .probing import probe
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
