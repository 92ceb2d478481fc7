"""Images, the result of a render: intensities with coordinates, units and provenance.

`image.py` holds the class, `tone.py` maps intensities to display values, `plot.py` draws an image
with axes, `row.py` draws several, `annotate/` adds a scale bar and other annotations, `sky.py`,
`hdu.py`, `beam.py` and `conversion.py` handle sky coordinates, beams and units, and `formats/` has
one module per file format.
"""

from .image import Image

__all__ = ["Image"]
