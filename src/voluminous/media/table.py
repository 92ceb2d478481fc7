"""Tables: colours and opacities given at values of a scalar, linear in between."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval import Interval
from ..units import plain, unit_of
from .contract import Coefficients, Context, Medium, check_plain
from .shaped import _named, _positive, _scalar


class Table(Medium):
    """Piecewise-linear colours and opacities; constant beyond both ends.

    Parameters
    ----------
    expr : str
        Expression x of the fields.
    values : array_like, shape (n,)
        Increasing values of x, at least two; two equal ones make a jump.
    colors : array_like, shape (n, channel) or (n,)
        Emission h_j at these values.
    opacities : array_like, shape (n,), (n, channel) or a number
        Extinction h_α at these values.
    path_length : float or Quantity
        Length to which colours and opacities refer.

    Raises
    ------
    InputError
        If shapes do not fit, values do not increase, opacities are negative, or a number is not
        finite.
    """

    def __init__(
        self, expr: Any, values: Any, colors: Any, opacities: Any, path_length: Any
    ) -> None:
        self.expr = Expression(expr)
        self.unit = unit_of(values)
        self.values = _increasing(plain(values, self.unit, "values"))
        n = len(self.values)
        self.colors = _columns(colors, n, "colors")
        self.opacities = _columns(opacities, n, "opacities")
        self.path_length = _scalar(path_length, "path_length")
        _positive(self.path_length, "path_length")
        self.channels = self.colors.shape[1]
        if self.opacities.shape[1] not in (1, self.channels):
            raise InputError(
                f"opacities must have one column (grey) or {self.channels}, "
                f"got {self.opacities.shape[1]}"
            )
        if self.opacities.min() < 0:
            raise InputError(f"opacities must not be negative, got {self.opacities.min():g}")
        self.grey = self.opacities.shape[1] == 1
        self.names = self.expr.names

    def coefficients(self, fields: dict[str, Any], context: Context) -> Coefficients:
        """Return j and α per unit length, interpolated in x."""
        x = context.evaluate(self.expr, fields)
        scale = 1.0 / plain(self.path_length, context.unit, "path_length")
        columns = [column * scale for column in (*self.colors.T, *self.opacities.T)]
        found = context.interpolate(x, self._nodes(context), columns)
        return Coefficients(found[: self.channels], found[self.channels :])

    def ranges(self, fields: dict[str, Interval], context: Context) -> Coefficients:
        """Return intervals that hold j and α: the formulas are the same."""
        return self.coefficients(fields, context)

    def _nodes(self, context: Context) -> np.ndarray:
        if self.unit is None:
            return np.ascontiguousarray(self.values)
        quantity = self.values * self.unit
        return np.ascontiguousarray(plain(quantity, context.unit_of(self.expr), "values"))

    def key(self) -> Any:
        """Return the expression and all numbers."""
        data = (self.values.tobytes(), self.colors.tobytes(), self.opacities.tobytes())
        shapes = (self.colors.shape, self.opacities.shape, str(self.unit))
        return ("Table", self.expr.text, *data, *shapes, _named(self.path_length))

    def describe(self) -> dict[str, Any]:
        """Return the medium as plain values."""
        return {
            "type": "table",
            "expr": self.expr.text,
            "values": self.values.tolist(),
            "colors": self.colors.tolist(),
            "opacities": self.opacities.tolist(),
            "path_length": _named(self.path_length),
        }


class Colormap(Table):
    """Colours from a matplotlib colormap, opacity uniform or as a function of the position in it.

    Parameters
    ----------
    expr : str
        Expression x of the fields.
    cmap : str or matplotlib.colors.Colormap
        Name or object; its RGB become three channels.
    vmin, vmax : float or Quantity
        Range of x; beyond it the colours of the ends go on.
    opacity : float or callable
        Extinction h_α, or a function of the position 0 … 1 in the colormap.
    path_length : float or Quantity
        Length to which colour and opacity refer: seen through one path length, a value shows the
        colour of the map times `opacity` (emission weighted by opacity, as in a picture).
    norm : str or matplotlib.colors.Normalize, optional
        How x maps to the position: ``"linear"``, ``"log"``, ``"symlog"`` … or an object.
    samples : int
        Number of entries taken from the map.

    Raises
    ------
    UnknownNameError
        If there is no such colormap or norm.
    InputError
        If the range is empty, or the norm cannot be applied to it.
    """

    def __init__(
        self,
        expr: Any,
        cmap: Any,
        vmin: Any,
        vmax: Any,
        opacity: Any,
        path_length: Any,
        *,
        norm: Any = None,
        samples: int = 256,
    ) -> None:
        from ..colormaps import get_colormap
        from .norms import values_at

        vmin, vmax = _scalar(vmin, "vmin"), _scalar(vmax, "vmax")
        unit = unit_of(vmin) or unit_of(vmax)
        low, high = plain(vmin, unit, "vmin"), plain(vmax, unit, "vmax")
        if not low < high:
            raise InputError(f"vmin must be below vmax, got {vmin} and {vmax}")
        if int(samples) != samples or samples < 2:
            raise InputError(f"samples must be a whole number of at least 2, got {samples!r}")
        self.map = get_colormap(cmap)
        position = np.linspace(0.0, 1.0, int(samples))
        values = values_at(position, norm, low, high)
        rgb = np.asarray(self.map(position))[:, :3]
        alpha = _opacities(opacity, position)
        self._described = {
            "type": "colormap",
            "cmap": self.map.name,
            "vmin": _named(vmin),
            "vmax": _named(vmax),
            "opacity": alpha.tolist() if callable(opacity) else float(opacity),
            "norm": norm if isinstance(norm, str) or norm is None else type(norm).__name__,
        }
        nodes = values * unit if unit is not None else values
        super().__init__(expr, nodes, rgb * alpha[:, None], alpha, path_length)

    def describe(self) -> dict[str, Any]:
        """Return the medium as plain values."""
        return {**self._described, "expr": self.expr.text, "path_length": _named(self.path_length)}


def _opacities(opacity: Any, position: np.ndarray) -> np.ndarray:
    """Return the opacity at positions in a colormap, from a number or a function of them."""
    given = [opacity(float(p)) for p in position] if callable(opacity) else opacity
    try:
        alpha = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"opacity must be a number or a function, got {opacity!r}") from error
    if alpha.shape not in ((), position.shape) or (alpha.ndim == 1 and not callable(opacity)):
        raise InputError(
            f"opacity must be one number, or a function that gives one, got {opacity!r}"
        )
    return np.broadcast_to(alpha, position.shape)


def _increasing(values: Any) -> np.ndarray:
    nodes = np.asarray(values, dtype=np.float64)
    if nodes.ndim != 1 or len(nodes) < 2:
        raise InputError(f"values must be at least two numbers, got shape {nodes.shape}")
    if not np.all(np.isfinite(nodes)):
        raise InputError("values must be finite")
    if np.any(np.diff(nodes) < 0):
        bad = int(np.flatnonzero(np.diff(nodes) < 0)[0])
        raise InputError(f"values must increase; {nodes[bad]:g} is followed by {nodes[bad + 1]:g}")
    return nodes


def _columns(data: Any, rows: int, what: str) -> np.ndarray:
    check_plain(data, what)
    try:
        array = np.asarray(data, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be numbers, got {data!r}") from error
    if array.ndim == 0:
        array = np.full(rows, float(array))
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or len(array) != rows or array.size == 0:
        raise InputError(f"{what} must have {rows} rows (one per value), got shape {array.shape}")
    if not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be finite")
    return np.ascontiguousarray(array)
