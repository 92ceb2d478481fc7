"""Snapshots of particles: SPH, moving meshes and N-body."""
