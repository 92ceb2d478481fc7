"""Volumes from yt data sets on their original cells, and a reader for files that yt supports."""

from .volume import from_yt

__all__ = ["from_yt"]
