"""What is tabulated per place, and how it becomes j and α in the loop and colours in the end.

In general that is j per channel and α per extinction (`Direct`). But in a grey medium made of
shapes (Gaussians, rectangles) every channel is a mixture of the same few shapes, attenuated alike.
Then the shapes are tabulated, the loop integrates one emission per SHAPE, and colours are mixed
into pixels afterwards (`Shapes`). For the two shells of `models.prestellar_core` that is half the
memory and 0.86 of the time, and turning a colour or an opacity classifies nothing again.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...media import Shaped
from ...media.contract import Medium
from .direct import Direct
from .emission_unit import unit_near
from .shapes import Shapes


def plan_numbers(medium: Medium, scheme: Any, backend: Any) -> Direct | Shapes:
    """Return what to tabulate for a medium: shapes where that is possible and fewer."""
    parts = tuple(part for part in medium.components() if isinstance(part, Shaped) and part.mixes)
    mixed = len(parts) < len(medium.components())
    if mixed or not scheme.linear or len(parts) > medium.channels:
        return Direct(medium)
    color = np.array([part.color for part in parts], dtype=np.float64).T
    unit = unit_near(float(np.max(np.abs(color))))
    color /= unit
    peak = [backend.opaque(most) for most in np.max(np.abs(color), axis=0)]
    opacity = [backend.opaque(part.opacity[0]) for part in parts]
    return Shapes(parts, color, opacity, peak, unit)
