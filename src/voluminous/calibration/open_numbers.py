"""Fill in a medium's parameters that depend on the volume: path lengths, colour ranges, units."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from ..errors import InputError, how_to_take
from ..expressions import Expression
from ..expressions.interval import Interval
from ..media import Colormap, Medium
from ..media.ranges import RangeContext
from ..media.sum import with_each
from ..volume import Volume
from .plain import in_plain_numbers
from .samples import pieces
from .thickness import Profile, thicknesses

# More shells are indistinguishable and take minutes to compile.
_MOST = 100


def check_volume(function: str, place: str, volume: Volume) -> None:
    """Raise InputError if ``volume`` is not a Volume."""
    if not isinstance(volume, Volume):
        raise InputError(
            f"{function} needs a vm.Volume {place}, got {type(volume).__name__}"
            f"{how_to_take(volume)}"
        )


def shell_count(n: Any) -> int:
    """Return the validated number of shells."""
    number: Any = n if isinstance(n, Real) else 0
    if not 1 <= number <= _MOST or int(number) != number:
        raise InputError(f"n must be a positive whole number of shells, {_MOST} at most, got {n!r}")
    return int(number)


def positive_opacity(opacity: Any) -> float:
    """Return the validated optical depth."""
    depth: Any = opacity if isinstance(opacity, Real) else 0
    if not 0 < depth <= sys.float_info.max:
        raise InputError(f"opacity must be positive and finite, one number, got {opacity!r}")
    return float(depth)


def nothing_to_see(expr: Any, value: float, where: str = "everywhere") -> InputError:
    """Return the error for an expression that is constant in a volume."""
    return InputError(
        f"{expr.text} is {value:g} {where}: there is nothing to see. Look at another field, or "
        "give a medium with numbers of your own: vm.Rectangle, or vm.Colormap with vmin and vmax"
    )


# Quantiles, by volume, of the visible values: the ends of a colour range.
_LOWEST, _HIGHEST = 0.005, 0.995
# A shell is visible where it reaches this fraction of its peak.
_SHOWN = 0.1
# A range narrower than so many rounding errors of its ends is a single value, and is widened.
_ROUNDINGS = 8
# Significant digits of the ends, which users read and retype.
_DIGITS = 3


def with_color_ranges(
    medium: Medium, volume: Volume, known: Callable[..., dict[Any, Any]]
) -> Medium:
    """Return the medium with all open ranges of `ColorBy` filled in; itself if none is open."""
    return with_each(medium, lambda part: _with_range(part, volume, known))


def _with_range(part: Any, volume: Volume, known: Callable[..., dict[Any, Any]]) -> Any:
    if isinstance(part, Colormap):
        gate = part.modulation
        return _closed(part, _Shown(volume, part.names, gate.visible_in, gate.gate_key()), known)
    color = getattr(getattr(part, "modulation", None), "color", None)
    if color is None or not color.range.is_open:
        return part
    shown = _Shown(volume, part.names, part.visible_in, part.visible_key())
    closed = _closed(color, shown, known)
    (name,) = (name for name, given in part.arguments().items() if given is color)
    return part.replace(**{name: closed})


@dataclass
class _Shown:
    """Visibility test of a part of a medium that depends on named fields; `key` identifies it."""

    volume: Volume
    names: tuple[str, ...]
    visible_in: Callable[..., Any]
    key: Any


def _closed(colors: Any, shown: _Shown, known: Callable[..., dict[Any, Any]]) -> Any:
    if not colors.range.is_open:
        return colors
    names = [Expression(name) for name in shown.names]
    for name in names:
        shown.volume.check_names(name)
    measured, key = known(colors.expr, *names), ("colors", shown.key, colors.range.positive)
    if key not in measured:
        measured[key] = _range(shown, colors)
    return colors.within(*measured[key], shown.volume.expression_unit(colors.expr))


def _range(shown: _Shown, color: Any) -> tuple[float, float]:
    """Return the range of nearly all visible values; of all values if none is visible."""
    values, sizes, seen = _cells(shown, color)
    if seen.any():
        values, sizes = values[seen], sizes[seen]
    if not len(values):
        which = "positive" if color.range.positive else "finite"
        raise InputError(
            f"{color.expr.text} has no {which} value in this volume: there is no range of colours"
        )
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(sizes[order])
    places = np.searchsorted(reached, np.array([_LOWEST, _HIGHEST]) * reached[-1])
    least = _ROUNDINGS * _eps(shown.volume, color.expr)
    if isinstance(color, Colormap) and _one_value(values.min(), values.max(), least):
        where = "wherever it is positive" if color.range.positive else "everywhere"
        raise nothing_to_see(color.expr, float(values[0]), where)
    low, high = values[order[np.minimum(places, len(values) - 1)]]
    return _rounded(float(low), float(high), least)


def _one_value(low: float, high: float, least: float) -> bool:
    return not high - low > least * max(abs(low), abs(high))


def _eps(volume: Volume, expr: Expression) -> float:
    """Return the relative rounding error of an expression: the largest epsilon of its fields."""
    kinds = (volume.array(name).dtype for name in expr.names if name in volume)
    floats: list[Any] = [np.float64, *(kind for kind in kinds if kind.kind == "f")]
    return max(float(np.finfo(kind).eps) for kind in floats)


def _cells(shown: _Shown, color: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the colour expression's cell values, the cell volumes, and a visibility mask."""
    volume, names = shown.volume, shown.names
    context = RangeContext(volume.unit, volume.expression_unit, _SHOWN)
    streams = [pieces(volume, Expression(name)) for name in names]
    found: list[tuple[np.ndarray, ...]] = []
    for own, *others in zip(pieces(volume, color.expr), *streams, strict=True):
        fields = {
            name: Interval(one.x - one.reach, one.x + one.reach)
            for name, one in zip(names, others, strict=True)
        }
        good = np.isfinite(own.x) & ((own.x > 0.0) | (not color.range.positive))
        with np.errstate(all="ignore"):
            seen = np.broadcast_to(shown.visible_in(fields, context), good.shape)
        for one in others:
            seen = seen & np.isfinite(one.x)
        found.append((own.x[good], np.broadcast_to(own.volume, good.shape)[good], seen[good]))
    values, sizes, there = (np.concatenate(column) for column in zip(*found, strict=True))
    return values, sizes, there


def _rounded(low: float, high: float, least: float) -> tuple[float, float]:
    """Return distinct ends of a range, rounded to few digits.

    A range no wider than `least` times its larger end is a single value, and is widened.
    """
    if _one_value(low, high, least):
        aside = 0.5 * abs(low) or 1.0
        return low - aside, high + aside
    first, last = (_to_digits(value, high - low) for value in (low, high))
    return (first, last) if first < last else (low, high)


def _to_digits(value: float, width: float) -> float:
    size = min(abs(value), width) or width
    return round(value, _DIGITS - 1 - int(np.floor(np.log10(size))))


def calibrate(medium: Medium, volume: Volume) -> Medium:
    """Return a medium with numbers measured in a volume; see `Medium.calibrated`."""
    check_volume("medium.calibrated", "first", volume)
    volume.refresh()  # derivatives of fields that were changed in place
    return calibrated(medium, volume, lambda *exprs: {})


def calibrated(medium: Medium, volume: Volume, known: Callable[..., dict[Any, Any]]) -> Medium:
    """Calibrate with cached measurements of the volume.

    Without the cache, measuring took ten times as long as the picture itself: 0.75 s of 0.8 s for a
    colormap in 4 million cells, 120 x 120 pixels.
    """
    plain = in_plain_numbers(medium, volume)
    return _with_lengths(with_color_ranges(plain, volume, known), volume, known)


def _with_lengths(medium: Medium, volume: Volume, known: Callable[..., dict[Any, Any]]) -> Medium:
    """Return the medium with all open path lengths filled in; itself if none is open."""
    parts = [p for p in medium.components() if _is_open(p)]
    if not parts:
        return medium
    lengths: dict[int, float] = {}
    for expr in dict.fromkeys(_scalar(p) for p in parts):
        same = [p for p in parts if _scalar(p) == expr]
        found = _lengths(same, volume, expr, known(expr))
        lengths.update({id(p): length for p, length in zip(same, found, strict=True)})
    return with_each(medium, lambda part: _with_length(part, lengths.get(id(part))))


def _is_open(medium: Medium) -> bool:
    return isinstance(medium.path_length, str)


def _scalar(medium: Medium) -> Expression:
    (expr,) = medium.scalars()
    return expr


def _lengths(
    media: list[Any], volume: Volume, expr: Expression, known: dict[Any, Any]
) -> list[float]:
    profiles = _profiles(media, volume, expr, known)
    missing = {p.key: p for p in profiles if p.key not in known}
    if missing:
        found = thicknesses(volume, expr, list(missing.values()))
        known.update({key: shell.length for key, shell in zip(missing, found, strict=True)})
    return [known[p.key] for p in profiles]


def _profiles(
    media: list[Any], volume: Volume, expr: Expression, known: dict[Any, Any]
) -> list[Profile]:
    volume.check_names(expr)
    unit = volume.expression_unit(expr)

    def extent() -> tuple[float, float]:
        if "extent" not in known:
            known["extent"] = extent_of(volume, expr)
        found: tuple[float, float] = known["extent"]
        return found

    return [Profile(*medium.profile(unit, extent)) for medium in media]


def extent_of(volume: Volume, expr: Expression) -> tuple[float, float]:
    """Return the least and the greatest finite value of an expression; zeros if there is none."""
    found = [piece.x[~np.isnan(piece.x)] for piece in pieces(volume, expr)]
    least = [float(x.min()) for x in found if x.size]
    greatest = [float(x.max()) for x in found if x.size]
    return (min(least), max(greatest)) if least else (0.0, 0.0)


def _with_length(medium: Medium, length: float | None) -> Any:
    if length is None:
        return medium
    return medium.changed(path_length=length)
