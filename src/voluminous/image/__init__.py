"""What comes out of a render: intensities with coordinates, units and the story of their making.

`image.py` holds the picture, `tone.py` turns intensities into something to look at, `plot.py`
draws it with axes, `row.py` several of them, `annotate/` puts a scale bar and the like over its
pixels, `celestial.py`, `hdu.py`, `beam.py` and `conversion.py` make it a map of the sky, and
`formats/` has one file per file format.
"""

from .image import Image

__all__ = ["Image"]
