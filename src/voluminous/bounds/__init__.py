"""Guaranteed bounds of pictures: everything that brackets a ray's intensity with certainty."""
