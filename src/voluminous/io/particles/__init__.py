"""Readers for particle snapshots: SPH, moving meshes and N-body."""
