"""Zarr, versions 2 and 3: plain arrays, named ones, and images of microscopes."""
