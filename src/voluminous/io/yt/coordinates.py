"""Coordinates of yt, and those of our grids that they become."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

_DEGREE = math.pi / 180


@dataclass(frozen=True)
class Axis:
    """A coordinate of ours: which one of yt it is, and how it follows from it."""

    name: str
    length: bool = True
    turned: bool = False
    of: Callable[[Any, np.ndarray], np.ndarray] | None = None

    def walls(self, ds: Any, values: np.ndarray) -> np.ndarray:
        """Return walls in this coordinate, from those in yt's."""
        return values if self.of is None else self.of(ds, values)


_THETA = Axis("latitude", False, True, lambda ds, x: (90 - x) * _DEGREE)
_PHI = Axis("longitude", False, False, lambda ds, x: x * _DEGREE)
GEOMETRIES: dict[str, tuple[str, tuple[Axis, ...]]] = {
    "cartesian": ("cartesian", (Axis("x"), Axis("y"), Axis("z"))),
    "cylindrical": ("cylindrical", (Axis("r"), Axis("theta", False), Axis("z"))),
    "polar": ("cylindrical", (Axis("r"), Axis("theta", False), Axis("z"))),
    "spherical": ("spherical", (Axis("r"), Axis("theta", False), Axis("phi", False))),
    "geographic": (
        "spherical",
        (Axis("altitude", of=lambda ds, x: x + _radius(ds, "surface_height", 0)), _THETA, _PHI),
    ),
    "internal_geographic": (
        "spherical",
        (
            Axis("depth", True, True, lambda ds, x: _radius(ds, "outer_radius", x.max()) - x),
            _THETA,
            _PHI,
        ),
    ),
}


def code_numbers(values: Any) -> np.ndarray:
    """Return lengths as plain numbers in the code's unit; angles are kept as such lengths."""
    if hasattr(values, "units"):
        values = values.to("code_length").d if not values.units.is_dimensionless else values.d
    return np.asarray(values, dtype=np.float64)


def _radius(ds: Any, name: str, otherwise: float) -> float:
    return float(code_numbers(getattr(ds, name, otherwise)))
