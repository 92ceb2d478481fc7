"""The lines of sight through the pixels' centres, on the host."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..backend import from_host, get_backend


def lines_of_sight(camera: Any, grid: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and unit directions of the rays, each of shape (ny, nx, 3).

    Directions run away from the observer. Distances along a ray count from its origin: the
    observer, or the plane through the centre of an orthographic camera.
    """
    frame, backend = camera.frame(grid), get_backend("cpu", "double")
    u, v = (a.ravel() for a in np.meshgrid(*frame.coordinates()))
    places = (from_host(backend.Wide, place) for place in (u, v))
    ray = camera.rays(frame.traced_vectors(backend), *places)
    nx, ny = frame.pixels

    def stacked(parts: Any) -> np.ndarray:
        rows = [np.broadcast_to(np.asarray(p), u.shape) for p in parts]
        return np.stack(rows, axis=-1).reshape(ny, nx, 3)

    return stacked(ray.origin), stacked(ray.direction)
