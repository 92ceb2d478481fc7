"""Readers for Athena++ (.athdf) and PLUTO (.dbl.h5) output; they only need h5py."""

from .pluto import PlutoReader
from .reader import AthenaReader

__all__ = ["AthenaReader", "PlutoReader"]
