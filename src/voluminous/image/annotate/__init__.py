"""Pictures with a scale bar, axes, colour bars, a title …; the picture's pixels stay unchanged.

`sheet.py` is what is drawn on: decorations in pixels of the picture, put over it in the end. There
is one file for each decoration, and `picture.py` holds the result.
"""

from .annotate import OPTIONS, annotate
from .sheet import Annotated

__all__ = ["OPTIONS", "Annotated", "annotate"]
