"""Rays: which, in what order, marched, and drawn again where they are not good enough."""
