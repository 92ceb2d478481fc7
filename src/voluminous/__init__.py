"""Physically based volume rendering."""
