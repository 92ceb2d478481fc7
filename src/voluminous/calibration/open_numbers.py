"""Fill in a medium's parameters that depend on the volume: path lengths, colour ranges, units."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from ..errors import InputError, UnitsError, how_to_take
from ..evaluation import Evaluation
from ..expressions import Expression
from ..expressions.interval import Interval
from ..media import Medium
from ..media.bound import Binding
from ..media.context import Feature
from ..media.details import Colors
from ..media.ranges import RangeContext
from ..media.sum import with_each
from ..units import Unit, unit_name
from ..volume import Volume
from .samples import cell_runs, measurable
from .thickness import Profile, thicknesses

# Returns the mutable cache of what was measured for some expressions.
Known: TypeAlias = Callable[..., dict[Any, Any]]

# Quantiles, by volume, of the visible values: the ends of a colour range.
_LOWEST, _HIGHEST = 0.005, 0.995
# A shell is visible where it reaches this fraction of its peak.
_SHOWN = 0.1
# A range narrower than so many rounding errors of its ends is a single value, and is widened.
_ROUNDINGS = 8
# Significant digits of the ends, which users read and retype.
_DIGITS = 3


def check_volume(function: str, place: str, volume: Volume) -> None:
    """Raise InputError if ``volume`` is not a Volume."""
    if not isinstance(volume, Volume):
        raise InputError(
            f"{function} needs a vm.Volume {place}, got {type(volume).__name__}"
            f"{how_to_take(volume)}"
        )


def nothing_to_see(expr: Expression, value: float, where: str = "everywhere") -> InputError:
    """Return the error for an expression that is constant in a volume."""
    return InputError(
        f"{expr.text} is {value:g} {where}: there is nothing to see. Look at another field, or "
        "give a medium with numbers of your own: vm.Rectangle, or vm.Colormap with vmin and vmax"
    )


def calibrate(medium: Medium, volume: Volume) -> Medium:
    """Return a medium with numbers measured in a volume; see `Medium.calibrated`."""
    check_volume("medium.calibrated", "first", volume)
    volume.refresh()  # derivatives of fields that were changed in place
    return calibrated(medium, volume, lambda *exprs: {})


def in_plain_numbers(medium: Medium, volume: Evaluation) -> Medium:
    """Return a medium whose expressions are plain numbers of a volume's fields, or refuse it.

    ``exp(-20 K/temperature)`` has a number for 20 K; emissivities that add up are in one unit, and
    extinctions per unit length of the volume. Components without a unit to convert are returned
    themselves.
    """
    medium = with_each(medium, lambda component: component.plain(volume))
    unit_of = volume.expression_unit
    wanted = medium.emission_unit(unit_of)
    if wanted is None:
        return medium

    def convert(component: Medium) -> Medium:
        if component.peak() == (0.0, 0.0, 0.0):
            return component
        if component.emission_unit(unit_of) != wanted:
            component = component.plain(volume, wanted)
        unit = component.emission_unit(unit_of)
        if unit != wanted:
            raise UnitsError(
                f"the components of this medium emit in {unit_name(wanted)} and in "
                f"{unit_name(unit) or 'plain numbers'} ({component!r}), which cannot be added; "
                "draw them apart, or give all of them emissivities of one kind"
            )
        return component

    return with_each(medium, convert)


def calibrated(medium: Medium, volume: Volume, known: Known) -> Medium:
    """Calibrate with cached measurements of the volume.

    Without the cache, measuring took ten times as long as the picture itself: 0.75 s of 0.8 s for a
    colormap in 4 million cells, 120 x 120 pixels.
    """
    plain, volume = in_plain_numbers(medium, volume), measurable(volume)
    ranged = with_each(plain, lambda component: _with_range(component, volume, known))
    return _with_lengths(ranged, volume, known)


def _with_lengths(medium: Medium, volume: Volume, known: Known) -> Medium:
    shells: dict[Expression, list[Medium]] = {}
    for component in medium.components():
        if isinstance(component.path_length, str):
            expr = scalar_of(component)
            if expr is None:
                raise InputError(f"{component!r} has no single expression: give a path_length")
            shells.setdefault(expr, []).append(component)
    lengths: dict[int, float] = {}
    for expr, components in shells.items():
        volume.check_names(expr)
        measured, unit = known(expr), volume.expression_unit(expr)

        def extent(expr: Expression = expr, measured: dict[Any, Any] = measured) -> Any:
            if "extent" not in measured:
                measured["extent"] = extent_of(volume, expr)
            return measured["extent"]

        profiles = [_profile(component, unit, extent) for component in components]
        missing = {p.key: p for p in profiles if p.key not in measured}
        if missing:
            found = thicknesses(volume, expr, list(missing.values()))
            measured.update({k: shell.length for k, shell in zip(missing, found, strict=True)})
        lengths |= {id(c): measured[p.key] for c, p in zip(components, profiles, strict=True)}
    return with_each(
        medium,
        lambda c: c.changed(path_length=lengths[id(c)]) if id(c) in lengths else c,
    )


def colors_of(component: Medium) -> Colors | None:
    """Return the colours of a component by the expression of which it is a function, if known."""
    features = component.features()
    return features[0].colors if features else None


def scalar_of(component: Medium) -> Expression | None:
    """Return the only expression of which it is a function; None of several fields, or none."""
    if colors_of(component) is not None:
        return component.features()[0].expr
    if component.scalars():
        return component.scalars()[0]
    return Expression(component.names[0]) if len(component.names) == 1 else None


def _profile(component: Medium, unit: Unit, extent: Callable[[], tuple[float, float]]) -> Profile:
    profile = component.profile(unit, extent)
    if profile is None:
        raise InputError(f"{component!r} has no profile, which is measured: give a path_length")
    return Profile(*profile)


def extent_of(volume: Volume, expr: Expression) -> tuple[float, float]:
    """Return the least and the greatest finite value of an expression; zeros if there is none."""
    values = [run.x[~np.isnan(run.x)] for run in cell_runs(volume, expr)]
    ends = [end for x in values if x.size for end in (float(x.min()), float(x.max()))]
    return (min(ends), max(ends)) if ends else (0.0, 0.0)


def _with_range(medium: Medium, volume: Volume, known: Known) -> Medium:
    for feature in medium.features():
        colors = feature.colors
        if colors is None or not colors.is_open:
            continue
        names = list(map(Expression, medium.names))
        for name in names:
            volume.check_names(name)
        measured = known(feature.expr, *names)
        key = ("colors", medium.visible_key(), colors.positive)
        if key not in measured:
            measured[key] = _range(volume, feature, medium)
        low, high = measured[key]
        medium = closed(medium, colors, low, high, volume.expression_unit(feature.expr))
    return medium


def closed(medium: Medium, colors: Colors, low: float, high: float, unit: Unit) -> Medium:
    """Return a medium with numbers in a unit for the open ends of a range of its colours.

    The ends are arguments of the medium, or of a `ColorBy` among its arguments.
    """
    ends = colors.closed(low, high, unit)
    nested = {
        name: given.replace(**ends)
        for name, given in medium.arguments().items()
        if getattr(given, "range", None) is colors
    }
    return medium.replace(**(nested or ends))


def _range(volume: Volume, feature: Feature, medium: Medium) -> tuple[float, float]:
    """Return the range of nearly all visible values; of all values if none is visible."""
    assert feature.colors is not None
    positive, expr = feature.colors.positive, feature.expr
    values, sizes, visible = _cells(volume, expr, medium, positive)
    if visible.any():
        values, sizes = values[visible], sizes[visible]
    if not len(values):
        raise InputError(
            f"{expr.text} has no {'positive' if positive else 'finite'} value in this volume: "
            "there is no range of colours"
        )
    kinds = [volume.array(name).dtype for name in expr.names if name in volume]
    kinds = [np.dtype(np.float64), *(kind for kind in kinds if kind.kind == "f")]
    least = _ROUNDINGS * max(float(np.finfo(kind).eps) for kind in kinds)
    if feature == medium.features()[0] and _is_single(values.min(), values.max(), least):
        where = "wherever it is positive" if positive else "everywhere"
        raise nothing_to_see(expr, float(values[0]), where)
    order = np.argsort(values, kind="stable")
    volumes = np.cumsum(sizes[order])
    places = np.searchsorted(volumes, np.array([_LOWEST, _HIGHEST]) * volumes[-1])
    low, high = map(float, values[order[np.minimum(places, len(values) - 1)]])
    if _is_single(low, high, least):
        aside = 0.5 * abs(low) or 1.0
        return low - aside, high + aside
    first, last = (_rounded(value, high - low) for value in (low, high))
    return (first, last) if first < last else (low, high)


def _cells(
    volume: Volume, expr: Expression, medium: Medium, positive: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # Where it shows does not depend on its path length.
    part = medium if medium.path_length is None else medium.changed(path_length=1.0)
    bound, context = part.bind(Binding.to(volume)), RangeContext(_SHOWN)
    columns: list[tuple[np.ndarray, ...]] = []
    samples = (cell_runs(volume, Expression(one)) for one in (expr.text, *medium.names))
    for shown, *others in zip(*samples, strict=True):
        fields = {
            name: Interval(one.x - one.reach, one.x + one.reach)
            for name, one in zip(medium.names, others, strict=True)
        }
        good = np.isfinite(shown.x) & ((shown.x > 0.0) | (not positive))
        with np.errstate(all="ignore"):
            visible = np.broadcast_to(bound.may_show(fields, context), good.shape)
        for one in others:
            visible = visible & np.isfinite(one.x)
        sizes = np.broadcast_to(shown.volume, good.shape)
        columns.append((shown.x[good], sizes[good], visible[good]))
    values, sizes, visible = (np.concatenate(column) for column in zip(*columns, strict=True))
    return values, sizes, visible


def _is_single(low: float, high: float, least: float) -> bool:
    return not high - low > least * max(abs(low), abs(high))


def _rounded(value: float, width: float) -> float:
    size = min(abs(value), width) or width
    return round(value, _DIGITS - 1 - int(np.floor(np.log10(size))))
