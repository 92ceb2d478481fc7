"""Media that fit the data: path lengths measured in a volume, and a first medium for any data."""

from . import presets
from .auto import auto
from .open_numbers import calibrate, calibrated

__all__ = ["auto", "calibrate", "calibrated", "presets"]
