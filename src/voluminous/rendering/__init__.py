"""The one ray loop: tiles of pixels, progress and cancellation. It returns planes of an image."""

from .framing import framed
from .prepare import prepare

__all__ = ["framed", "prepare"]
