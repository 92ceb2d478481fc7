"""Arrays whose dimensions have names and coordinates: xarray, NetCDF, and Zarr with names."""
