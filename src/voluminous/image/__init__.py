"""Images, the result of a render: intensities with coordinates, units and provenance.

`image.py` holds the class, `tone.py` maps intensities to display values, `plot.py` draws images
with axes, one, several in a row, or the channels of a cube, `annotate/` adds a scale bar and other
annotations, `sky.py`, `hdu.py` and `conversion.py` handle sky coordinates, beams and
units, and `formats/` has one module per file format. `fits_header.py` says what a FITS header
means, also to `io.fits`.

`cube.py` holds the class of images with a spectrum in every pixel; its channels are places on a
`spectral_axis.py`. `spectra.py` makes moments, continua, cuts and spectra (`spectrum.py`) of it.
"""

from .cube import Cube
from .image import Image
from .spectral_axis import SpectralAxis, channels
from .spectrum import Spectrum

__all__ = ["Cube", "Image", "SpectralAxis", "Spectrum", "channels"]
