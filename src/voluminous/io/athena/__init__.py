"""Athena++ output (.athdf), read with h5py alone."""

from .reader import AthenaReader

__all__ = ["AthenaReader"]
