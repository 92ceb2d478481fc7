"""Media that fit the data: path lengths measured in a volume, and a first medium for any data."""

from . import presets
from .open_numbers import calibrated
from .suggest import suggest_medium

__all__ = ["calibrated", "presets", "suggest_medium"]
