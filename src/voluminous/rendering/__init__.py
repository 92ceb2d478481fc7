"""render(): the one ray loop, tiles, progress and cancellation."""

from .api import render
from .prepare import prepare

__all__ = ["prepare", "render"]
