"""Images, the result of a render: intensities with coordinates, units and provenance.

`image.py` holds the class, `cube.py` that of images with a spectrum in every pixel (its places are
a `spectral_axis.py`), `tone.py` maps intensities to display values, `plot.py` draws an image
with axes, `row.py` draws several, `annotate/` adds a scale bar and other annotations, `sky.py`,
`hdu.py`, `beam.py` and `conversion.py` handle sky coordinates, beams and units, and `formats/` has
one module per file format.
"""

from .cube import Cube
from .image import Image
from .spectral_axis import SpectralAxis, channels

__all__ = ["Cube", "Image", "SpectralAxis", "channels"]
