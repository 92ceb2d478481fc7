"""Guaranteed bounds of a picture."""
