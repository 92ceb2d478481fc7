"""Media for data of a known kind: computed tomography, magnetic resonance, fluorescence.

Each preset is a function ``preset(volume, field=None, **overrides)`` that returns a medium: shaded
tables of colour and opacity. Overrides are arguments of `voluminous.Table`, such as ``shading=0``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..media import Medium, Sum, Table
from ..volume import Volume
from .labels import labels
from .open_numbers import check_volume, nothing_to_see
from .samples import measurable
from .suggest import main_scalar

__all__ = [
    "bone",
    "fluorescence",
    "labels",
    "lung",
    "mr_angiography",
    "mr_head",
    "muscle",
    "skin_and_bone",
    "vessels",
]

# Opacities are optical depths along this part of the longest side of the volume.
_PART = 1 / 100
_IVORY, _SKIN, _FLESH = (1, 0.95, 0.85), (0.9, 0.6, 0.45), (0.75, 0.25, 0.2)
_BLOOD, _GREY, _WHITE, _AIR = (0.9, 0.1, 0.1), (0.6, 0.55, 0.55), (1, 1, 1), (0.35, 0.55, 0.75)
# Colours of channels that have none.
_CHANNELS = ((0, 1, 0), (1, 0, 1), (0, 1, 1), (1, 1, 0), (1, 0, 0), (0.3, 0.5, 1))
_HARD = [(350, 3, _IVORY), (1200, 8, _IVORY), (3000, 8, _WHITE)]
# Points (value, opacity, colour).
Points = Sequence[tuple[float, float, Sequence[float]]]


def bone(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium for bone in CT (Hounsfield units)."""
    return _table(volume, field, [(150, 0, _FLESH), *_HARD], overrides)


def skin_and_bone(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium for bone under translucent skin in CT (Hounsfield units)."""
    skin = [(-650, 0, _SKIN), (-400, 1.2, _SKIN), (-200, 0.8, _SKIN), (-120, 0, _SKIN)]
    return _table(volume, field, [*skin, (180, 0, _FLESH), *_HARD], overrides)


def muscle(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium for muscle, with bone, in CT (Hounsfield units)."""
    soft = [(-20, 0, _FLESH), (30, 1, _FLESH), (90, 1.5, _FLESH), (180, 1.5, _FLESH)]
    return _table(volume, field, [*soft, (350, 4, _IVORY), (3000, 8, _WHITE)], overrides)


def lung(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium for airways and lungs in CT (Hounsfield units)."""
    points = [(-980, 0, _AIR), (-850, 0.15, _AIR), (-600, 0.5, _SKIN), (-450, 0, _SKIN)]
    return _table(volume, field, points, overrides)


def vessels(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium for vessels with contrast agent in CT (Hounsfield units)."""
    points = [(120, 0, _BLOOD), (220, 2, _BLOOD), (400, 4, (1, 0.5, 0.35)), (700, 6, _IVORY)]
    return _table(volume, field, points, overrides)


def mr_head(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium for T1-weighted MR: levels follow from the values of this volume."""
    low, middle, high = _levels(volume, field, (60, 85, 99.5))
    points = [(low, 0, _GREY), (middle, 0.4, _SKIN), (high, 3, _WHITE)]
    return _table(volume, field, points, overrides)


def mr_angiography(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium for time-of-flight MR: the brightest 2 % of the values of this volume."""
    low, middle, high = _levels(volume, field, (98, 99.3, 99.95))
    points = [(low, 0, _BLOOD), (middle, 2, _BLOOD), (high, 5, (1, 0.6, 0.4))]
    return _table(volume, field, points, overrides)


def fluorescence(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium that shows channels of a microscope in their colours.

    Colours and display windows are those of ``volume.meta["channels"]``; what is not given there is
    chosen, windows so that the brightest 0.2 % are of full colour.
    """
    check_volume("fluorescence", "first", volume)
    channels = dict(volume.meta.get("channels") or {})
    names = [field] if field is not None else [n for n in volume.fields if n in channels]
    tables = []
    for number, name in enumerate(names or [main_scalar(volume).text]):
        entry = channels.get(str(name)) or {}
        low, high = entry.get("window") or _levels(volume, name, (50, 99.8))
        color = tuple(entry.get("color") or _CHANNELS[number % len(_CHANNELS)])
        options = {"shading": 0.0, **overrides}
        tables.append(_table(volume, name, [(low, 0, color), (high, 1, color)], options, 1 / 20))
    return Sum(tuple(tables)) if len(tables) > 1 else tables[0]


def _levels(volume: Volume, field: Any, percentiles: Sequence[float]) -> list[float]:
    expr = main_scalar(volume) if field is None else Expression(field)
    values = np.asarray(measurable(volume).evaluate(expr), dtype=np.float64)
    values = values[np.isfinite(values)]
    if not values.size:
        raise InputError(f"{expr.text} has no finite value in this volume; choose another field")
    if values.min() == values.max():
        raise nothing_to_see(expr, float(values[0]))
    levels = np.maximum.accumulate(np.percentile(values, percentiles))
    least = 1e-6 * max(float(np.abs(values).max()), 1e-300)
    return [float(v) for v in levels + least * np.arange(len(levels))]


def _table(
    volume: Volume, field: Any, points: Points, overrides: dict[str, Any], part: float = _PART
) -> Medium:
    check_volume("a preset", "first", volume)
    expr = main_scalar(volume) if field is None else Expression(field)
    unit = volume.expression_unit(expr)
    values, opacities, colors = (
        np.array(column, dtype=float) for column in zip(*points, strict=True)
    )
    given = {
        "values": values if unit is None else values * unit,
        "colors": colors * opacities[:, None],
        "opacities": opacities,
        "path_length": part * float(np.ptp(volume.grid.bounds, axis=1).max()),
        "shading": 0.7,
    }
    return Table(expr, **{**given, **overrides})


def __dir__() -> list[str]:
    return sorted(__all__)
