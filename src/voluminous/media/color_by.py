"""Colours of a medium by a second expression, other than the one that shapes it."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.types import Float, Mask
from ..colormaps import colormap_name, get_colormap, mapped_colors
from ..errors import InputError, unknown_name
from ..expressions import Expression
from ..expressions.interval import Interval
from ..expressions.traced_interval import TracedInterval
from ..units import Unit, plain, unit_of
from ..value import Value
from .arguments import channel_values, described, named, scalar, whole_number
from .context import Context, Feature
from .details import Colors
from .piecewise_linear import PiecewiseLinear

if TYPE_CHECKING:
    from ..bounds.enclosure import EnclosedPanel, EnclosureContext
    from .bound import Binding
    from .panel import Panel


# Default number of entries taken from a colormap.
SAMPLES = 256
_MOST_SAMPLES = 1 << 16


class ColorScale(Colors):
    """Colours of a matplotlib colormap at increasing values; constant beyond both ends.

    Ends of the range that are not given are open, to be measured later (`closed`). Before, `values`
    are the places in the map.

    Attributes
    ----------
    position, values : array, shape (samples,)
        Places in the map from 0 to 1, and the values that map there, in `unit`.
    rows : array, shape (samples, 3)
        Red, green and blue there, from 0 to 1.
    """

    def __init__(self, cmap: Any, vmin: Any, vmax: Any, norm: Any, samples: int) -> None:
        self.cmap, self.norm = cmap, norm
        self.samples = whole_number(samples, "samples", 2, _MOST_SAMPLES)
        self.vmin, self.vmax = (
            getattr(norm, what, None) if given is None else scalar(given, what)
            for what, given in (("vmin", vmin), ("vmax", vmax))
        )
        self.position = self.values = np.linspace(0.0, 1.0, self.samples)
        self.rows = mapped_colors(get_colormap(cmap), self.position)
        self.is_open = self.vmin is None or self.vmax is None
        name = norm if isinstance(norm, str) else type(norm).__name__
        self.positive = name in ("log", "LogNorm")
        self._unit: Unit = None
        if self.is_open:
            named_only = norm is None or isinstance(norm, str)
            _norm(norm, *((1.0, 2.0) if named_only else (self.vmin, self.vmax)))
            return
        self._unit = unit_of(self.vmin) or unit_of(self.vmax)
        low, high = plain(self.vmin, self.unit, "vmin"), plain(self.vmax, self.unit, "vmax")
        if not low < high:
            raise InputError(f"vmin must be below vmax, got {self.vmin} and {self.vmax}")
        fitted = _norm(norm, low, high)
        try:
            self.values = np.array(fitted.inverse(self.position), dtype=np.float64)
        except (ValueError, AttributeError) as error:
            raise InputError(
                f"a {type(norm).__name__} cannot be used from {low:g} to {high:g}: {error}; use an "
                "invertible norm, such as 'linear' or 'log', or a Table"
            ) from error
        self.values[0], self.values[-1] = low, high

    @property
    def unit(self) -> Unit:
        return self._unit

    def values_in(self, unit: Unit) -> np.ndarray:
        self.measured()
        values = self.values if self.unit is None else self.values * self.unit
        return np.ascontiguousarray(plain(values, unit, "vmin"))

    def measured(self) -> ColorScale:
        """Return it; raise InputError if an end of the range is open."""
        if self.is_open:
            raise InputError(
                "the range of these colours is measured in a volume: give vmin and vmax, or take "
                "medium.calibrated(volume)"
            )
        return self

    def closed(self, low: float, high: float, unit: Unit) -> dict[str, Any]:
        ends = {"vmin": self.vmin, "vmax": self.vmax}
        measured = super().closed(low, high, unit)
        return {name: measured[name] if end is None else end for name, end in ends.items()}

    def key(self) -> tuple[Any, ...]:
        self.measured()
        return (self.values.tobytes(), self.rows.tobytes(), str(self.unit))

    def describe(self) -> dict[str, Any]:
        """Return colormap, range and norm as plain values, without open ends."""
        norm = self.norm
        values = {
            "cmap": colormap_name(get_colormap(self.cmap)),
            "vmin": named(self.vmin),
            "vmax": named(self.vmax),
            "norm": norm if isinstance(norm, str) or norm is None else type(norm).__name__,
            "samples": None if self.samples == SAMPLES else self.samples,
        }
        return {key: value for key, value in values.items() if value is not None}


def _norm(norm: Any, vmin: Any, vmax: Any) -> Any:
    """Return an invertible matplotlib norm over a range, from its name (default linear) or itself.

    A norm object is copied, and takes the range where it has none.
    """
    from matplotlib import colors

    if norm is None or isinstance(norm, str):
        name = norm or "linear"
        linear_below = 1e-3 * max(abs(vmin), abs(vmax))
        makers: dict[str, Callable[[], Any]] = {
            "linear": lambda: colors.Normalize(vmin, vmax),
            "log": lambda: colors.LogNorm(vmin, vmax),
            "symlog": lambda: colors.SymLogNorm(linear_below, vmin=vmin, vmax=vmax),
            "asinh": lambda: colors.AsinhNorm(linear_below, vmin=vmin, vmax=vmax),
        }
        if name not in makers:
            raise unknown_name("norm", name, makers)
        if name == "log" and vmin <= 0:
            raise InputError(f"a logarithmic norm needs a positive vmin, got {vmin:g}")
        return makers[name]()
    if not isinstance(norm, colors.Normalize):
        raise InputError(f"norm must be the name of a norm or a matplotlib one, got {norm!r}")
    fitted = copy.deepcopy(norm)
    for what, value in (("vmin", vmin), ("vmax", vmax)):
        end = getattr(fitted, what)
        if end is None:
            setattr(fitted, what, value)
        elif end != value:
            raise InputError(
                f"{what} is {value:g}, but the norm has {what} = {end:g}; "
                f"give the same, or a norm without {what}"
            )
    return fitted


class ColorBy(Value):
    """Colours from a colormap of an expression: three channels, red, green and blue.

    Parameters
    ----------
    expr : str
        Expression of the fields that gives the position in the colormap.
    cmap : str or matplotlib.colors.Colormap
        Name or object.
    vmin, vmax : float or Quantity, optional
        Range of `expr`; colours are constant beyond it. Where `expr` is NaN, nothing is emitted.
        A missing end is measured when a volume is drawn, as in `Medium.calibrated`, so that the
        range holds 99 % of what the medium shows.
    norm : str or matplotlib.colors.Normalize, optional
        How `expr` maps to the position: ``"linear"``, ``"log"``, ``"symlog"`` … or an object.
    brightness : float
        The colours are multiplied with this number.
    samples : int
        Number of entries taken from the map.

    Raises
    ------
    UnknownNameError
        If there is no such colormap or norm.
    InputError
        If the range is empty, the norm cannot be applied to it, or a number is not finite.

    Examples
    --------
    >>> import voluminous as vm
    >>> warmth = vm.ColorBy("temperature", "inferno", 10, 1e4, norm="log")
    >>> shell = vm.Gaussian("density", 1.0, 0.1, warmth, 1.0, 1.0, where="abs(velocity_z) > 5")
    >>> shell.names
    ('density', 'velocity_z', 'temperature')
    >>> vm.ColorBy("temperature", "inferno")  # in the range that there is
    ColorBy(expr='temperature', cmap='inferno')
    """

    channels = 3

    def __init__(
        self,
        expr: Any,
        cmap: Any,
        vmin: Any = None,
        vmax: Any = None,
        norm: Any = None,
        *,
        brightness: float = 1.0,
        samples: int = SAMPLES,
    ) -> None:
        self.expr = Expression(expr)
        self.range = ColorScale(cmap, vmin, vmax, norm, samples)
        values = channel_values(brightness, "brightness")
        if len(values) != 1:
            raise InputError(f"brightness must be one number, got {brightness!r}")
        self.brightness = values[0]
        self.names = self.expr.names

    @property
    def feature(self) -> Feature:
        """The expression, with its colours."""
        return Feature(self.expr, colors=self.range)

    @property
    def scale(self) -> ColorScale:
        """The colours over their range; an InputError if that has not been measured."""
        return self.range.measured()

    def bind(self, binding: Binding) -> BoundColors:
        """Return the colours with numbers in the units of a volume."""
        return BoundColors(self, binding)

    def key(self) -> tuple[Any, ...]:
        """Return the expression and all numbers."""
        return ("ColorBy", self.expr.text, *self.range.key(), self.brightness)

    def describe(self) -> dict[str, Any]:
        return {**described(self), **self.range.describe()}

    def __repr__(self) -> str:
        return f"ColorBy({', '.join(f'{k}={v!r}' for k, v in self.describe().items())})"


class BoundColors:
    """The numbers of a `ColorBy`: entries at values of its expression, of the drawn channels.

    An open range is refused when colours are asked for.
    """

    def __init__(self, by: ColorBy, binding: Binding) -> None:
        self.expr, self._range, self.rgb = by.expr, by.range, by.range.rows[:, binding.channels]
        self._part, unit = binding.part, binding.unit_of(by.expr)
        self._nodes = None if by.range.is_open else by.range.values_in(unit)

    @property
    def nodes(self) -> np.ndarray:
        """The values of the colormap's entries in the unit of the expression."""
        return self._range.measured().values if self._nodes is None else self._nodes

    def colors(self, fields: dict[str, Any], context: Context) -> list[Float]:
        """Return red, green and blue, from 0 to 1, at places; or intervals that hold them."""
        x = context.evaluate(self.expr, fields)
        return [*map(_or_black, context.interpolate(x, self.nodes, [*self.rgb.T]))]

    def seen(self, fields: dict[str, Any], context: Context) -> list[Float]:
        """Return red, green and blue on a ray, in the type that integrals are computed with."""
        x = context.narrow(context.evaluate(self.expr, fields))
        table = context.keep(
            (self._part, "colors"), lambda: PiecewiseLinear(type(x), self.nodes, self.rgb)
        )
        return [_or_black(value) for value in table.values(x)]

    def panel_colors(
        self, panel: EnclosedPanel, context: EnclosureContext
    ) -> tuple[list[TracedInterval], list[TracedInterval]]:
        """Return intervals of the colours on a panel, and of their means."""
        means = panel.table_means(self.expr, self.nodes, self.rgb)
        return self.colors(panel.fields, context), means

    def turns(self, panel: Panel, least: float) -> Mask:
        """Return where its expression may reverse by more than a part of its range."""
        extent = float(self.nodes[-1] - self.nodes[0])
        return panel.turns(self.expr, panel.context.kept_number(least * extent))


def _or_black(value: Float) -> Float:
    """Return a colour, zero where it is NaN; of an interval, one that holds zero there."""
    if not isinstance(value, Interval):
        return dr.select(dr.isnan(value), 0.0, value)
    where: Any = dr.select if isinstance(value, TracedInterval) else np.where
    low = where(value.nan, 0.0, value.lo)
    return type(value)(low, where(value.nan, 1.0, value.hi))
