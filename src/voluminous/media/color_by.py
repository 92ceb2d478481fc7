"""Colours of a medium by another expression than the one that shapes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval import Interval
from ..expressions.traced_interval import TracedInterval
from ..units import plain
from ..value import Value
from .color_scale import SAMPLES, ColorScale, OpenRange
from .context import Context
from .given import channel_values
from .table_means import PiecewiseLinear

if TYPE_CHECKING:
    from .stretch import Stretch


class ColorBy(Value):
    """Colours from a colormap of an expression: three channels, red, green and blue.

    Parameters
    ----------
    expr : str
        Expression of the fields that tells the place in the colormap.
    cmap : str or matplotlib.colors.Colormap
        Name or object.
    vmin, vmax : float or Quantity, optional
        Range of `expr`; beyond it the colours of the ends go on. Where it has no value (NaN),
        nothing is emitted. What is not given is measured when a volume is drawn, as in
        `Medium.calibrated`: so that 99 % of what the medium shows is between.
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
        self.range = OpenRange(cmap, vmin, vmax, norm, samples)
        values = channel_values(brightness, "brightness")
        if len(values) != 1:
            raise InputError(f"brightness must be one number, got {brightness!r}")
        self.brightness = values[0]
        self.names = self.expr.names

    @property
    def scale(self) -> ColorScale:
        """The colours over their range.

        Raises
        ------
        InputError
            If the range has not been measured.
        """
        return self.range.scale

    def within(self, low: float, high: float, unit: Any) -> ColorBy:
        """Return it with what is not given of the range, in the unit of the expression."""
        closed = self.range.closed(low, high, unit)
        return self.replace(vmin=closed.vmin, vmax=closed.vmax)

    def colors(self, fields: dict[str, Any], context: Context) -> list[Any]:
        """Return red, green and blue, from 0 to 1, at places; or intervals that hold them."""
        x = context.evaluate(self.expr, fields)
        found = context.interpolate(x, self.nodes(context), list(self.scale.rgb.T))
        return [_or_black(value) for value in found]

    def seen(self, fields: dict[str, Any], context: Context) -> list[Any]:
        """Return red, green and blue on a ray, in the type that integrals are computed with."""
        x = context.narrow(context.evaluate(self.expr, fields))
        table = context.keep(
            (id(self), "table"),
            lambda: PiecewiseLinear(type(x), self.nodes(context), self.scale.rgb),
        )
        return [_or_black(value) for value in table.values(x)]

    def turns(self, stretch: Stretch, context: Context, least: float) -> Any:
        """Return where it may go back and forth by more than a part of its range."""
        nodes = self.nodes(context)
        most = context.keep(
            (id(self), "range"), lambda: context.number(least * float(nodes[-1] - nodes[0]))
        )
        return stretch.turns(self.expr, most)

    def key(self) -> tuple[Any, ...]:
        """Return the expression and all numbers."""
        data = (self.scale.values.tobytes(), self.scale.rgb.tobytes())
        return ("ColorBy", self.expr.text, *data, str(self.scale.unit), self.brightness)

    def describe(self) -> dict[str, Any]:
        """Return it as plain values: what a scene file says of it."""
        told = {"expr": self.expr.text, **self.range.describe()}
        if self.brightness != 1.0:
            told["brightness"] = self.brightness
        return {key: value for key, value in told.items() if value is not None}

    def nodes(self, context: Context) -> np.ndarray:
        """Return the values of the colormap's entries in the unit of the expression."""
        values, unit = self.scale.values, self.scale.unit
        if unit is None:
            return values
        return np.ascontiguousarray(plain(values * unit, context.unit_of(self.expr), "vmin"))

    def __repr__(self) -> str:
        return f"ColorBy({', '.join(f'{k}={v!r}' for k, v in self.describe().items())})"


def _or_black(value: Any) -> Any:
    """Return a colour, zero where it is NaN; of an interval, one that holds zero there."""
    if not isinstance(value, Interval):
        return dr.select(dr.isnan(value), 0.0, value)
    where: Any = dr.select if isinstance(value, TracedInterval) else np.where
    low = where(value.nan, 0.0, value.lo)
    return type(value)(low, where(value.nan, 1.0, value.hi))
