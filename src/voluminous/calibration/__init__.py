"""Media that fit the data: path lengths measured in a volume, and a first medium for any data."""

from . import presets
from .auto import auto
from .calibrate import calibrate, calibrated

__all__ = ["auto", "calibrate", "calibrated", "presets"]
