"""FITS: cubes of images, on the sky and along a spectrum or in space."""

from .reader import CASAReader, FITSReader

__all__ = ["CASAReader", "FITSReader"]
