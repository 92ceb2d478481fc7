"""Athena++ (.athdf) and PLUTO (.dbl.h5) output, read with h5py alone."""

from .pluto import PlutoReader
from .reader import AthenaReader

__all__ = ["AthenaReader", "PlutoReader"]
