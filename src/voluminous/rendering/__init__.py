"""render(): the one ray loop, tiles, progress and cancellation."""

from .api import render

__all__ = ["render"]
