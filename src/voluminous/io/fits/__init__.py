"""FITS: cubes of images, on the sky and along a spectrum or in space."""

from .casa import CASAReader
from .reader import FITSReader

__all__ = ["CASAReader", "FITSReader"]
