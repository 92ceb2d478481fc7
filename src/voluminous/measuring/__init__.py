"""Measurements: columns, projections, moments, totals, surfaces of optical depth, and `probe`."""

from ..errors import immutable
from .columns import Moments, column, moments
from .probe_result import Probe
from .probing import probe
from .projections import TauSurface, project, tau_surface
from .totals import Measurement, measure

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
