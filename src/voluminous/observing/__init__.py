"""What telescopes see: cubes and spectra of volumes."""

from .cubes import observe

__all__ = ["observe"]
