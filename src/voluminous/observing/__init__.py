"""What telescopes see: cubes and spectra of volumes."""

from .cubes import observe
from .spectra import spectrum

__all__ = ["observe", "spectrum"]
