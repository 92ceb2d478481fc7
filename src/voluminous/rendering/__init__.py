"""render(): the one ray loop, tiles, progress and cancellation."""

from .render import render

__all__ = ["render"]
