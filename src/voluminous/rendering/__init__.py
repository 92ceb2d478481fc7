"""render(): the one ray loop, tiles, progress and cancellation."""

from .api import render
from .framing import framed
from .planning import plan
from .prepare import prepare
from .sky import image_wcs

__all__ = ["framed", "image_wcs", "plan", "prepare", "render"]
