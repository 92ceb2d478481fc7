"""What one ray saw: a real march, written down segment by segment."""

from .api import probe
from .result import Probe

__all__ = ["Probe", "probe"]
