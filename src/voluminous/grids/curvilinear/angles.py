"""Angles of spherical and cylindrical grids."""

from __future__ import annotations

import numpy as np

FULL_CIRCLE, MIDPLANE = 2 * np.pi, 0.5 * np.pi
# Azimuths and polar angles in single precision end where they should to this.
ANGLE_ROUNDING = 1e-6


def is_closed(edges: np.ndarray) -> bool:
    """Return True if azimuths span a full circle."""
    return bool(abs(edges[-1] - edges[0] - FULL_CIRCLE) < 1e-9)
