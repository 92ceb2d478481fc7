"""Cells between planes of x, y and z, as many along each axis: uniform and rectilinear."""
