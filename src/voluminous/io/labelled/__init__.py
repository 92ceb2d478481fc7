"""Arrays whose dimensions have names and coordinates: xarray, NetCDF, and Zarr with names."""

from .convert import from_xarray

__all__ = ["from_xarray"]
