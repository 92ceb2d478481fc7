"""Physics on the host: constants, opacities, molecules and spectra, in CGS units. Only NumPy."""

from .constants import CODATA, RADMC3D, Constants, constants_named

__all__ = ["CODATA", "RADMC3D", "Constants", "constants_named"]
