"""Media that are a function of one scalar: a shape times a colour and an opacity per path length.

A component is T(x) = h / path_length · shape(x), with h each entry of `color` for the emissivity
and of `opacity` for the extinction: seen through one path length of its peak, it shows its colour.
"""

from __future__ import annotations

from typing import Any

from ..errors import InputError
from ..expressions import Expression, Ops
from ..expressions.interval import Interval
from ..units import is_quantity, parse_unit, plain, unit_name
from .contract import Coefficients, Context, Medium, channel_values, check_extinction


class Shaped(Medium):
    """Common part of `Gaussian` and `Rectangle`."""

    _width_name = ""

    def __init__(
        self, expr: Any, center: Any, width: Any, color: Any, opacity: Any, path_length: Any
    ) -> None:
        self.expr = Expression(expr)
        self.center = _scalar(center, "center")
        self.width = _scalar(width, self._width_name)
        self.color = channel_values(color, "color")
        self.opacity = channel_values(opacity, "opacity")
        self.path_length = _scalar(path_length, "path_length")
        check_extinction(self.opacity, len(self.color), "opacity")
        _positive(self.width, self._width_name)
        _positive(self.path_length, "path_length")
        if len(set(self.opacity)) == 1:  # the same for all channels: grey
            self.opacity = self.opacity[:1]
        self.channels = len(self.color)
        self.grey = len(self.opacity) == 1
        self.names = self.expr.names

    def shape(self, ops: Ops, offset: Any, width: Any) -> Any:
        """Return the shape at a distance from the centre; one at its peak."""
        raise NotImplementedError

    def coefficients(self, fields: dict[str, Any], context: Context) -> Coefficients:
        """Return j and α per unit length."""
        shape = self.per_length(fields, context)
        return Coefficients(
            [context.number(h) * shape for h in self.color],
            [context.number(h) * shape for h in self.opacity],
        )

    def per_length(self, fields: dict[str, Any], context: Context) -> Any:
        """Return the shape per path length: what colour and opacity are multiplied with."""
        unit = context.unit_of(self.expr)
        center = plain(self.center, unit, "center")
        width = plain(self.width, unit, self._width_name)
        length = plain(self.path_length, context.unit, "path_length")
        x = context.evaluate(self.expr, fields)
        shape = self.shape(context.ops, x - context.number(center), context.number(width))
        return context.number(1.0 / length) * shape

    def ranges(self, fields: dict[str, Interval], context: Context) -> Coefficients:
        """Return intervals that hold j and α: the formulas are the same."""
        return self.coefficients(fields, context)

    def shape_key(self) -> Any:
        """Return what `per_length` depends on, units included."""
        numbers = (_named(self.center), _named(self.width), _named(self.path_length))
        return (type(self).__name__, self.expr.text, *numbers)

    def key(self) -> Any:
        """Return the class and all its numbers, units included."""
        return (*self.shape_key(), self.color, self.opacity)

    def describe(self) -> dict[str, Any]:
        """Return the medium as plain values."""
        return {
            "type": type(self).__name__.lower(),
            "expr": self.expr.text,
            "center": _named(self.center),
            self._width_name: _named(self.width),
            "color": list(self.color),
            "opacity": self.opacity[0] if self.grey else list(self.opacity),
            "path_length": _named(self.path_length),
        }


class Gaussian(Shaped):
    """A Gaussian shell: T = h/path_length · exp(-((x - center)/sigma)²/2).

    Parameters
    ----------
    expr : str
        Expression x of the fields, e.g. ``"log10(density)"``.
    center, sigma : float or Quantity
        Where the shell is, and how wide, in x.
    color : float or sequence
        Emission h_j per channel: the intensity of one `path_length` of the peak, thin.
    opacity : float or sequence
        Extinction h_α, one for all channels (grey) or one per channel: the optical depth of one
        `path_length` of the peak.
    path_length : float or Quantity
        Length to which `color` and `opacity` refer; plain numbers are in the volume's unit.

    Raises
    ------
    InputError
        For a negative opacity, a width or path length that is not positive, or anything not finite.

    Notes
    -----
    Peters, *The physics of volume rendering* (2014), section 4.
    """

    _width_name = "sigma"

    def __init__(
        self, expr: Any, center: Any, sigma: Any, color: Any, opacity: Any, path_length: Any
    ) -> None:
        super().__init__(expr, center, sigma, color, opacity, path_length)

    def shape(self, ops: Ops, offset: Any, width: Any) -> Any:
        """Return exp(-(offset/σ)²/2); zero at infinity."""
        scaled = offset / width
        return ops.exp(-0.5 * (scaled * scaled))


class Rectangle(Shaped):
    """A shell of constant coefficients: T = h/path_length up to `half_width` from the centre.

    Parameters
    ----------
    expr : str
        Expression x of the fields.
    center, half_width : float or Quantity
        Where the shell is, and half how wide, in x.
    color, opacity, path_length
        As in `Gaussian`.

    Notes
    -----
    The rectangle function of Peters, *The physics of volume rendering* (2014), section 4.
    """

    _width_name = "half_width"

    def __init__(
        self, expr: Any, center: Any, half_width: Any, color: Any, opacity: Any, path_length: Any
    ) -> None:
        super().__init__(expr, center, half_width, color, opacity, path_length)

    def shape(self, ops: Ops, offset: Any, width: Any) -> Any:
        """Return one within the half width, else zero; NaN stays NaN."""
        box = ops.number(abs(offset) <= width)
        return ops.where(offset == offset, box, offset)


def _scalar(value: Any, what: str) -> Any:
    """Return a finite float, or a Quantity left as it is until the volume's unit is known."""
    import math

    magnitude = value.value if is_quantity(value) else value
    try:
        number = float(magnitude)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be one number or quantity, got {value!r}") from error
    if not math.isfinite(number):
        raise InputError(f"{what} must be finite, got {value!r}")
    return value if is_quantity(value) else number


def _positive(value: Any, what: str) -> None:
    magnitude = value.value if is_quantity(value) else value
    if magnitude <= 0:
        raise InputError(f"{what} must be positive, got {value}")


def _named(value: Any) -> Any:
    """Return a number, or a quantity as text such as ``"2.5e+16 cm"``."""
    if is_quantity(value):
        return f"{float(value.value)!r} {unit_name(parse_unit(value.unit))}".strip()
    return value
