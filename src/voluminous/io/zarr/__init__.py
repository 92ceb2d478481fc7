"""Zarr, versions 2 and 3, in directories and in ZIP files: plain arrays, named ones, microscopy."""
