"""Data sets of yt on their own cells, and files that yt can read."""

from .volume import from_yt

__all__ = ["from_yt"]
