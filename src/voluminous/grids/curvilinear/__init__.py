"""Cells between spheres, cones, cylinders and half planes."""
