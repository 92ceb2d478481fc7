"""The package's file format: every grid with all its fields, in self-describing HDF5."""
