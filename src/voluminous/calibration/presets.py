"""Media for data of a known kind: computed tomography, magnetic resonance, fluorescence.

Each preset is a function ``preset(volume, field=None, **overrides)`` that returns a medium: shaded
tables of colour and opacity. Overrides are arguments of `voluminous.Table`, such as ``shading=0``.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..grids import CartesianGrid
from ..media import Medium, Sum, Table
from ..volume import Volume
from .histogram import sampled_values
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
_BLOOD, _GREY, _WHITE, _SKY = (0.9, 0.1, 0.1), (0.6, 0.55, 0.55), (1, 1, 1), (0.35, 0.55, 0.75)
# Colours of channels that have none.
_CHANNELS = ((0, 1, 0), (1, 0, 1), (0, 1, 1), (1, 1, 0), (1, 0, 0), (0.3, 0.5, 1))
_HARD = [(350, 3, _IVORY), (1200, 8, _IVORY), (3000, 8, _WHITE)]
# Least part of the cells in a peak of CT; fat, and more than metal has, in HU; bytes that are air;
# fields in which CT is looked for.
_PEAK, _FAT, _METAL, _AIR, _FIELDS = 0.02, -100.0, 66_000, 20, 2
# Colours of fluorescent dyes and proteins, by words in the names of channels; light that is not
# seen, beyond red, is shown as magenta.
_DYES = (
    (r"dapi|hoechst|bfp|pacific.?blue|draq5|alexa.?(fluor.?)?(350|405)|\b405", (0.2, 0.4, 1)),
    (r"cfp|cerulean|turquoise", (0, 1, 1)),
    (r"yfp|venus|citrine|alexa.?(fluor.?)?(514|532)", (1, 1, 0)),
    (r"cy5|cy7|far.?red|irfp|sir\b|alexa.?(fluor.?)?(6|7)\d\d|\b6[3-9]\d|atto.?647", (1, 0, 1)),
    (r"gfp|fitc|cy2|calcein|neon.?green|alexa.?(fluor.?)?488|\b488", (0, 1, 0)),
    (
        r"cherry|rfp|texas|tritc|cy3|tomato|dsred|ruby|rhod|propidium|alexa.?(fluor.?)?5[4-9]\d|"
        r"alexa.?(fluor.?)?610|\b5[4-9]\d",
        (1, 0, 0),
    ),
    (r"bright.?field|\bbf\b|\bdic\b|phase|transmi", (1, 1, 1)),
)
# Points (value, opacity, colour).
Points = Sequence[tuple[float, float, Sequence[float]]]


def recognised(volume: Volume) -> tuple[list[str], list[str]]:
    """Return the names of presets for data such as a volume's, the best first, and notes.

    Labels have a table; channels, names in a microscope's file; CT is found by `hounsfield` among
    up to two other fields, if none has a unit. The notes say what presets do to the values.
    """
    tables, channels = (volume.meta.get(key) or {} for key in ("labels", "channels"))
    fields = [name for name in volume.fields if name not in tables]
    scale, names = None, ["mr_head", "mr_angiography"]
    if len(channels) > 1 and all(name in channels for name in fields):
        names = ["fluorescence"]
    elif volume.meta.get("modality") != "MR":
        scale = ct_scale(volume, fields)
        names = [] if scale is None else ["skin_and_bone", "bone", "muscle", "vessels", "lung"]
    words = [] if scale is None or scale[1:] == (1.0, 0.0) else [_words(*scale)]
    return [*(["labels"] if "labels" in volume.meta else []), *names], words


def ct_scale(volume: Volume, fields: Sequence[str]) -> tuple[str, float, float] | None:
    """Return the first field of CT among a few, and its `hounsfield`."""
    units = [volume.field_unit(name) for name in fields]
    if isinstance(volume.grid, CartesianGrid) and len(fields) <= _FIELDS and not any(units):
        for name in fields:
            if (scale := hounsfield(volume, name)) is not None:
                return (name, *scale)
    return None


def hounsfield(volume: Volume, field: Any = None) -> tuple[float, float] | None:
    """Return slope and intercept of a field of CT: its values are slope · HU + intercept.

    (1, 0) are Hounsfield units: by DICOM's rescale type or modality, the word ct in the field's
    name, or two peaks that no other data have, air at -1000 (twice as much as is in the range of
    lung) and water at 0. The same in values without a sign, as scanners store them, is (1, 1024).
    Bytes of such a file hide the units: peaks of air and soft tissue stand for -1000 and 40.
    None if the field is likely no CT.
    """
    expr = main_scalar(volume) if field is None else Expression(field)
    named = volume.meta.get("rescale_type") == "HU" or volume.meta.get("modality") == "CT"
    named |= re.search(r"(^|_)ct(_|\d|$)", expr.text, re.IGNORECASE) is not None
    values = sampled_values(measurable(volume), expr)
    if not len(values) or (named and values[0] < _FAT and values[-1] < _METAL):
        return (1.0, 0.0) if len(values) else None
    if _are_bytes(values):
        return _of_bytes(values) if named else None
    shift = 0.0 if values[0] < 0.0 else 1024.0

    def share(low: float, high: float) -> float:
        ends = np.searchsorted(values, [low + shift, high + shift])
        return float(ends[1] - ends[0]) / len(values)

    air, lung, water = share(-np.inf, -850), share(-800, -550), share(-150, 150)
    beside = max(share(-450, -150), share(150, 450))
    peaks = air > max(_PEAK, 2 * lung) and water > max(_PEAK, 2 * beside)
    return (1.0, shift) if peaks and 150 < values[-1] - shift < _METAL else None


def _are_bytes(values: np.ndarray) -> bool:
    return bool(values[0] >= 0 and _AIR < values[-1] <= 255)


def _of_bytes(values: np.ndarray) -> tuple[float, float]:
    smooth = np.convolve(np.bincount(values.astype(int)), np.ones(3), "same")
    air = int(smooth[: _AIR + 1].argmax())
    tissue = air + _AIR + int(smooth[air + _AIR :].argmax())
    slope = (tissue - air) / 1040.0
    return slope, air + 1000.0 * slope


def _words(name: str, slope: float, intercept: float) -> str:
    air, tissue = (slope * unit + intercept for unit in (-1000, 40))
    return (
        f"{name} is not in Hounsfield units; presets of CT are rescaled: air at {air:.4g}, soft "
        f"tissue at {tissue:.4g}"
    )


def bone(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium for bone in CT (Hounsfield units)."""
    return _ct(volume, field, [(150, 0, _FLESH), *_HARD], overrides)


def skin_and_bone(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium for bone under translucent skin in CT (Hounsfield units)."""
    skin = [(-650, 0, _SKIN), (-400, 1.2, _SKIN), (-200, 0.8, _SKIN), (-120, 0, _SKIN)]
    return _ct(volume, field, [*skin, (180, 0, _FLESH), *_HARD], overrides)


def muscle(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium for muscle, with bone, in CT (Hounsfield units)."""
    soft = [(-20, 0, _FLESH), (30, 1, _FLESH), (90, 1.5, _FLESH), (180, 1.5, _FLESH)]
    return _ct(volume, field, [*soft, (350, 4, _IVORY), (3000, 8, _WHITE)], overrides)


def lung(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium for airways and lungs in CT (Hounsfield units)."""
    points = [(-980, 0, _SKY), (-850, 0.15, _SKY), (-600, 0.5, _SKIN), (-450, 0, _SKIN)]
    return _ct(volume, field, points, overrides)


def vessels(volume: Volume, field: Any = None, **overrides: Any) -> Medium:
    """Return a medium for vessels with contrast agent in CT (Hounsfield units)."""
    points = [(120, 0, _BLOOD), (220, 2, _BLOOD), (400, 4, (1, 0.5, 0.35)), (700, 6, _IVORY)]
    return _ct(volume, field, points, overrides)


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

    Colours and display windows are those of ``volume.meta["channels"]``, but for several that are
    all white; else colours follow from the names of dyes and proteins (DAPI blue, GFP green,
    mCherry red, Cy5, which is not seen, magenta) or are chosen, and windows so that the brightest
    0.2 % are of full colour.
    """
    check_volume("fluorescence", "first", volume)
    channels = dict(volume.meta.get("channels") or {})
    names = [field] if field is not None else [n for n in volume.fields if n in channels]
    tables = []
    white = [(channels.get(str(name)) or {}).get("color") == [1.0, 1.0, 1.0] for name in names]
    for number, name in enumerate(names or [main_scalar(volume).text]):
        entry = dict(channels.get(str(name)) or {})
        if len(white) > 1 and all(white):
            del entry["color"]
        label = f"{entry.get('label', '')} {name}".replace("_", " ")
        entry.setdefault("color", _dye(label))
        low, high = entry.get("window") or _levels(volume, name, (50, 99.8))
        color = tuple(entry.get("color") or _CHANNELS[number % len(_CHANNELS)])
        options = {"shading": 0.0, **overrides}
        tables.append(_table(volume, name, [(low, 0, color), (high, 1, color)], options, 1 / 20))
    return Sum(tuple(tables)) if len(tables) > 1 else tables[0]


def _ct(volume: Volume, field: Any, points: Points, overrides: dict[str, Any]) -> Medium:
    check_volume("a preset", "first", volume)
    others = [name for name in volume.fields if name not in volume.meta.get("labels", ())]
    found = ct_scale(volume, others) if field is None else None
    expr = Expression(found[0] if found else main_scalar(volume) if field is None else field)
    scale = found[1:] if found else hounsfield(volume, expr)
    values = sampled_values(measurable(volume), expr)
    if scale is None and len(values) and _are_bytes(values):
        scale = _of_bytes(values)
        warnings.warn(_words(expr.text, *scale), stacklevel=3)
    slope, intercept = scale or (1.0, 0.0)
    rows = [(slope * value + intercept, opacity, color) for value, opacity, color in points]
    return _table(volume, expr, rows, overrides)


def _dye(label: str) -> Sequence[float] | None:
    found = (color for words, color in _DYES if re.search(words, label, re.IGNORECASE))
    return next(found, None)


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
