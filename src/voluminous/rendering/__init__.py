"""render(): the one ray loop, tiles, progress and cancellation."""

from .api import render
from .framing import framed
from .prepare import prepare
from .sky import image_wcs

__all__ = ["framed", "image_wcs", "prepare", "render"]
