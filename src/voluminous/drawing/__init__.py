"""`render`: from a volume, a medium and a camera to an image."""

from .api import render
from .sky import image_wcs

__all__ = ["image_wcs", "render"]
