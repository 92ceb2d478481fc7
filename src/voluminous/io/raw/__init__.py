"""Bare numbers in a file, whose shape and type are told elsewhere."""
