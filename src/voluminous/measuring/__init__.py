"""Measurements: what the same integral along rays says of mass, momentum, energy and columns."""

from .column import column

__all__ = ["column"]
