"""Stars, lines and other things, each at its depth in a picture."""
