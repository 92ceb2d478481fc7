"""The package's own files: every grid with all its fields, in HDF5 that explains itself."""
