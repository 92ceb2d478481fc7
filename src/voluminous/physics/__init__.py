"""Physics on the host: constants, opacities, molecules and spectra, in CGS units. Only NumPy."""

from .constants import CODATA, RADMC3D, Constants, constants_named
from .molecule import Molecule
from .opacity import Opacity
from .spectra import Blackbody, TabulatedSpectrum

__all__ = [
    "CODATA",
    "RADMC3D",
    "Blackbody",
    "Constants",
    "Molecule",
    "Opacity",
    "TabulatedSpectrum",
    "constants_named",
]
