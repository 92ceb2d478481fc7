"""Volumes larger than memory: their blocks, and pictures of them, drawn one block after another."""
