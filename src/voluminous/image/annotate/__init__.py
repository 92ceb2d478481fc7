"""Pictures with a scale bar, axes, colour bars, a title …; the picture's pixels stay unchanged.

`annotate.py` interprets the options, `marks.py` and `scales.py` draw annotations, and `sheet.py`
holds the canvas and the result.
"""

from .annotate import OPTIONS, annotate
from .sheet import Annotated

__all__ = ["OPTIONS", "Annotated", "annotate"]
