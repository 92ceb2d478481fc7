"""Tables: colours and opacities given at values of a scalar, linear in between."""

from __future__ import annotations

import functools
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.functions import precision_of
from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval import Interval
from ..units import plain, unit_of
from .bends import bend, thinness
from .color_by import ColorBy
from .context import Context
from .contract import WIDE, Coefficients, Medium, check_plain
from .crossings import NOISE, passes
from .front_light import extent_of, unseen_change
from .given import named
from .modulation import Modulation, kept
from .path_length import given_path_length, length_in
from .sampled import BEND, PAIR, Sampled
from .stretch import extremes
from .table_means import PiecewiseLinear, Place
from .table_middles import TableMiddles
from .table_structure import jumps, structures, visible_range
from .unseen_place import misplaced_change

if TYPE_CHECKING:
    from .course import CourseContext, Courses
    from .part_bounds import PartBounds
    from .stretch import Panel, Stretch

# Control points that stick out by this part of a structure's width call for smaller panels.
_DOUBT = 0.25
# What is left of that where x only just reaches what shows.
_REACHED = 2.0**-8
# Emission and extinction that differ by less, as parts of their peaks, vary alike.
_EVEN = 1e-9
# A structure is a ramp up and one down.
_RAMPS = 2.0
# Half of how far apart the ends of a stretch are, over the distance of two samples.
_TO_ENDS = 0.5 / (PAIR[1] - PAIR[0])


class Table(Medium):
    """Piecewise-linear colours and opacities; constant beyond both ends.

    Parameters
    ----------
    expr : str
        Expression x of the fields.
    values : array_like, shape (n,)
        Increasing values of x, at least two; two equal ones make a jump.
    colors : array_like, shape (n, channel) or (n,), or ColorBy
        Emission h_j at these values. With a `ColorBy`: the opacity times a colour by another
        expression.
    opacities : array_like, shape (n,), (n, channel) or a number
        Extinction h_α at these values.
    path_length : float, Quantity or "auto", default "auto"
        Length to which colours and opacities refer; ``"auto"`` as in `Gaussian`, for the width of
        all that is opaque (or, where nothing is, bright) in the volume's range of x.
    where : str, optional
        As in `Gaussian`.

    Raises
    ------
    InputError
        If shapes do not fit, values do not increase, opacities are negative, or a number is not
        finite.
    """

    def __init__(
        self,
        expr: Any,
        values: Any,
        colors: Any,
        opacities: Any,
        path_length: Any = "auto",
        *,
        where: Any = None,
    ) -> None:
        self.expr = Expression(expr)
        self.unit = unit_of(values)
        self.values = _increasing(plain(values, self.unit, "values"))
        n = len(self.values)
        self.opacities = _columns(opacities, n, "opacities")
        by = colors if isinstance(colors, ColorBy) else None
        self.colors = _columns(colors, n, "colors") if by is None else _shared(self.opacities, by)
        self.path_length = given_path_length(path_length)
        self.channels = self.colors.shape[1]
        if self.opacities.shape[1] not in (1, self.channels):
            raise InputError(
                f"opacities must have one column (grey) or {self.channels}, "
                f"got {self.opacities.shape[1]}"
            )
        if self.opacities.min() < 0:
            raise InputError(f"opacities must not be negative, got {self.opacities.min():g}")
        self.grey = self.opacities.shape[1] == 1
        self.modulation = Modulation(where, by, self.channels)
        self.names = tuple(dict.fromkeys((*self.expr.names, *self.modulation.names)))

    @property
    def color(self) -> tuple[float, ...]:
        """The brightest emission of each channel."""
        return tuple(np.abs(self.colors).max(axis=0).tolist())

    def coefficients(self, fields: dict[str, Any], context: Context) -> Coefficients:
        """Return j and α per unit length, interpolated in x."""
        x = context.evaluate(self.expr, fields)
        scale = 1.0 / self._length(context)
        columns = [column * scale for column in (*self.colors.T, *self.opacities.T)]
        result = self.split(context.interpolate(x, self._nodes(context), columns))
        return self.modulation.coefficients(result, fields, context)

    def expressions(self) -> tuple[tuple[Expression, Any], ...]:
        """Return the expression, with the narrowest interval of the table, and the modulation's."""
        steps = np.diff(self.values)
        least = float(steps[steps > 0].min())
        width = least if self.unit is None else least * self.unit
        return ((self.expr, width), *self.modulation.expressions())

    @property
    def looks_inside(self) -> bool:
        """Whether colours or a gate are looked up between a panel's ends."""
        return not self.modulation.fixed

    def scalars(self) -> tuple[Expression, ...]:
        """Return the expression that the table is a function of."""
        return (self.expr,)

    def means(self, panel: Panel, context: Context) -> Coefficients:
        """Return the means of j and α over a panel, exact if x is linear there."""
        stretch = panel.stretch
        ends = [self._place(stretch, s, context) for s in (panel.first, panel.last)]
        heights = context.keep((id(self), "heights"), lambda: self._heights(context))
        table = self._table(context, type(ends[0].x))
        means = table.means(*ends)[: len(heights)]
        result = self.split([h * v for h, v in zip(heights, means, strict=True)])
        if self.modulation.fixed:
            return result
        middles = context.keep((id(self), "middles"), lambda: self._middles(context, table.real))
        return self.modulation.means(result, panel, context, middles.between(*ends))

    @property
    def smooth(self) -> bool:
        """Whether there are neither jumps in the table nor kinks in x, and nothing else varies."""
        jumps = np.any(np.diff(self.values) == 0)
        return self.modulation.fixed and self.expr.smooth and not jumps

    def sampled(self, stretch: Stretch, context: Context) -> Sampled:
        """Return the means of j and α over a stretch from samples; see `Medium.sampled`.

        Two of them are exact for the lines between nodes (x is a cubic), and off by as much as the
        table bends at nodes on the way.
        """
        if not self.smooth:
            return super().sampled(stretch, context)
        low, high, *samples = (
            context.narrow(x)
            for x in (*stretch.hull(self.expr), *(stretch.scalar(self.expr, s) for s in PAIR))
        )
        table = self._table(context, type(low))
        first, second, _ = (context.narrow(d) for d in stretch.derivatives(self.expr))
        off = BEND * table.bends(low, high, first + second)
        heights = context.keep((id(self), "heights"), lambda: self._heights(context))
        a, b = ([h * v for h, v in zip(heights, table.values(x), strict=True)] for x in samples)
        # The line through both samples: √3 of their difference is that of its ends.
        middle = [0.5 * (p + q) for p, q in zip(a, b, strict=True)]
        lean = [_TO_ENDS * (q - p) for p, q in zip(a, b, strict=True)]
        start, end = (
            [m + way * d for m, d in zip(middle, lean, strict=True)] for way in (-1.0, 1.0)
        )
        return Sampled(*map(self.split, (middle, start, end, [h * off for h in heights])))

    def visible(self, stretch: Stretch, context: Context) -> tuple[Any, Any]:
        """Return where an entry may be noticeable, and where a panel's ends may not show that."""
        low, high = (context.narrow(x) for x in stretch.hull(self.expr))
        nodes = [context.narrow(x) for x in stretch.nodes(self.expr)]
        below, above = extremes(nodes)
        real = type(low)
        first, last = context.keep((id(self), "range"), lambda: self._kept_range(context, real))
        seen = ~((low > last) | (high < first))  # where there is NaN, it must show
        hidden = seen & False
        for doubt, begin, end in context.keep(
            (id(self), "structures"), lambda: self._kept_structures(context, real)
        ):
            hidden |= (high > above + doubt) & (above < end) & (high > begin)
            hidden |= (low < below - doubt) & (below > begin) & (low < end)
            hidden |= (low < end) & (high > begin) & stretch.turns(self.expr, doubt)
        hidden |= seen & self._entered(stretch, context)
        if not self.modulation.fixed:
            hidden |= seen & self._misplaced(stretch, context)[1]
        for edge in context.keep((id(self), "jumps"), lambda: self._kept_jumps(context)):
            # However little it goes beyond a jump, what is there counts.
            possible, shown = passes(stretch, self.expr, edge)
            hidden |= seen & (possible > shown)
        return self.modulation.visible(stretch, context, seen, hidden)

    def _entered(self, stretch: Stretch, context: Context) -> Any:
        """Return where x reaches what shows, and no end does: of an opaque table little is much."""
        low, high = stretch.hull(self.expr)
        nodes = stretch.nodes(self.expr)
        below, above = extremes(nodes)
        real = type(context.narrow(nodes[0]))
        found = context.keep((id(self), "structures"), lambda: self._kept_structures(context, real))
        if not found:
            return stretch.length < 0.0
        first, last = context.keep((id(self), "range"), lambda: self._kept_range(context, real))
        noise = NOISE[precision_of(type(low))] * extremes([dr.abs(low), dr.abs(high)])[1]
        least = _REACHED * found[0][0] + noise
        return ((above <= first) & (high > first + least)) | (
            (below >= last) & (low < last - least)
        )

    def cores(self, stretch: Stretch, context: Context) -> list[Any]:
        """Return how many structures are in each half: two where colours vary in one narrower.

        One of them is in front of the other, and panels may agree about a mixture of both.
        """
        nodes = [context.narrow(x) for x in stretch.nodes(self.expr)]
        real = type(nodes[0])
        found = context.keep((id(self), "structures"), lambda: self._kept_structures(context, real))
        within = stretch.length * 0.0 + (1.0 if self._even else 2.0)
        counts = []
        for low, high in map(extremes, pairwise(nodes)):
            count = stretch.length * 0.0
            for doubt, first, last in found:
                own = dr.select(_DOUBT * (high - low) > doubt, within, WIDE)
                there = (low < last) & (high > first)
                count = extremes([count, dr.select(there, own, 0.0)])[1]
            counts.append(count)
        return counts

    @property
    def _even(self) -> bool:
        """Whether what is in front of what makes no difference."""
        shown = np.flatnonzero(np.abs(self._rows).max(axis=0))
        absorbs = bool((shown >= self.channels).any())
        return not absorbs or bool(np.ptp(self._shape[:, shown], axis=1).max() < _EVEN)

    def sharpness(self, stretch: Stretch, context: Context) -> tuple[Any, Any]:
        """Return how thin the narrowest structure is, and what bends of x may do to it."""
        real = type(context.narrow(stretch.scalar(self.expr, 0.0)))
        found = context.keep((id(self), "structures"), lambda: self._kept_structures(context, real))
        first, last = context.keep((id(self), "range"), lambda: self._kept_range(context, real))
        if not found:  # the same everywhere
            return stretch.length * 0.0, stretch.length * 0.0
        least = functools.reduce(
            lambda a, b: dr.select(a < b, a, b), [doubt for doubt, *_ in found]
        )
        narrowness = _DOUBT / least
        off = bend(stretch, self.expr, narrowness, context.narrow, first, last)
        off = off + self._unseen_change(stretch, context, least)
        if not self.modulation.fixed:
            off = off + self._misplaced(stretch, context)[0]
        return thinness(stretch, self.expr, narrowness, context.narrow), off

    def _unseen_change(self, stretch: Stretch, context: Context, least: Any) -> Any:
        """Return how far off a colour may be that varies within the narrowest structure."""
        if self.modulation.color is None:
            return stretch.length * 0.0
        heights = context.keep((id(self), "heights"), lambda: self._heights(context))
        nodes = [context.narrow(x) for x in stretch.nodes(self.expr)]
        extent = extent_of(nodes, (_RAMPS / _DOUBT) * least)
        way = 0.5 * stretch.length * dr.select(extent < 1.0, extent, 1.0)
        depth = extremes(heights[self.channels :])[1] * way
        return unseen_change(self.modulation, stretch, context, extent, depth)

    def _misplaced(self, stretch: Stretch, context: Context) -> tuple[Any, Any]:
        """Return how far off what is looked up where a line passes a structure may be, and lost."""
        real = type(context.narrow(stretch.scalar(self.expr, 0.0)))
        found = context.keep((id(self), "structures"), lambda: self._kept_structures(context, real))
        ranges = [(low, high) for _, low, high in found[:1]]
        if not ranges:
            return stretch.length * 0.0, stretch.length < 0.0
        thin = thinness(stretch, self.expr, _DOUBT / found[0][0], context.narrow)
        return misplaced_change(self.modulation, stretch, context, self.expr, ranges, thin)

    def visible_in(self, fields: dict[str, Interval], context: Context) -> Any:
        """Return where an entry may be noticeable while the fields stay in ranges."""
        x = context.evaluate(self.expr, fields)
        found = context.interpolate(x, self._nodes(context), list(self._shape.T))
        seen: Any = x.nan
        for value in found:
            seen = seen | (value.size > context.faint)
        return seen & self.modulation.visible_in(fields, context)

    def visible_key(self) -> Any:
        """Return the expression, all entries and the gate."""
        return (*self._entries(), self.modulation.gate_key())

    def ranges(self, fields: dict[str, Interval], context: Context) -> Coefficients:
        """Return intervals that hold j and α: the formulas are the same."""
        return self.coefficients(fields, context)

    def on_panel(self, courses: Courses, context: CourseContext) -> list[PartBounds]:
        """Return what is certain on a panel."""
        from .mean_bounds import table_parts

        length = length_in(self.path_length, context.unit)
        return table_parts(self, length, courses, context)

    @property
    def _rows(self) -> np.ndarray:
        return np.concatenate([self.colors, self.opacities], axis=1)

    @property
    def _peaks(self) -> np.ndarray:
        peaks = np.abs(self._rows).max(axis=0)
        return np.where(peaks > 0, peaks, 1.0)

    @property
    def _shape(self) -> np.ndarray:
        """All columns, each over its peak."""
        return np.ascontiguousarray(self._rows / self._peaks)

    @property
    def _weight(self) -> np.ndarray:
        """The mean of all columns' magnitudes: where the mass is."""
        return np.abs(self._shape).mean(axis=1)

    def _table(self, context: Context, real: Any) -> PiecewiseLinear:
        def make() -> PiecewiseLinear:
            columns = self._shape
            if not self.modulation.fixed:
                columns = np.concatenate([columns, self._weight[:, None]], axis=1)
            return PiecewiseLinear(real, self._nodes(context), columns)

        return context.keep((id(self), "table"), make)

    def _middles(self, context: Context, real: Any) -> TableMiddles:
        return TableMiddles(real, self._nodes(context), self._weight)

    def _place(self, stretch: Stretch, s: float, context: Context) -> Place:
        """Return where x lies in the table at an end or in the middle of a stretch."""

        def make() -> Place:
            x = context.narrow(stretch.scalar(self.expr, s))
            return self._table(context, type(x)).at(x)

        return kept(stretch, (id(self), s), make)

    def _length(self, context: Context) -> float:
        return length_in(self.path_length, context.unit)

    def _heights(self, context: Context) -> list[Any]:
        length = self._length(context)
        units = [context.radiance] * self.channels + [1.0] * self.opacities.shape[1]
        factors = self._peaks / np.array(units) * (context.scale / length)
        return [context.narrow(context.number(float(h))) for h in factors]

    def _kept_range(self, context: Context, real: Any) -> list[Any]:
        found = visible_range(self._nodes(context), self._shape, context.faint)
        return [dr.opaque(real, value) for value in found]

    def _kept_structures(self, context: Context, real: Any) -> list[list[Any]]:
        found = structures(self._nodes(context), self._shape)
        return [[dr.opaque(real, v) for v in (_DOUBT * w, low, high)] for w, low, high in found]

    def _kept_jumps(self, context: Context) -> list[Any]:
        return [context.number(x) for x in jumps(self._nodes(context), self._shape)]

    def _nodes(self, context: Context) -> np.ndarray:
        if self.unit is None:
            return np.ascontiguousarray(self.values)
        quantity = self.values * self.unit
        return np.ascontiguousarray(plain(quantity, context.unit_of(self.expr), "values"))

    def key(self) -> Any:
        """Return the expression and all numbers."""
        return (*self._entries(), named(self.path_length), self.modulation.key())

    def _entries(self) -> tuple[Any, ...]:
        data = (self.values.tobytes(), self.colors.tobytes(), self.opacities.tobytes())
        shapes = (self.colors.shape, self.opacities.shape, str(self.unit))
        return ("Table", self.expr.text, *data, *shapes)

    def describe(self) -> dict[str, Any]:
        """Return the medium as plain values."""
        return {
            "type": "table",
            "expr": self.expr.text,
            "values": self.values.tolist(),
            "colors": self.colors.tolist(),
            "opacities": self.opacities.tolist(),
            "path_length": named(self.path_length),
            **self.modulated(),
        }

    def modulated(self) -> dict[str, Any]:
        """Return gate and colours as plain values."""
        told = self.modulation.described()
        return {"colors" if key == "color" else key: value for key, value in told.items()}


def _shared(opacities: np.ndarray, by: ColorBy) -> np.ndarray:
    """Return the opacity times the brightness in three channels, to be coloured."""
    if opacities.shape[1] not in (1, 3):
        raise InputError(f"opacities must have one column or 3, got {opacities.shape[1]}")
    return by.brightness * np.broadcast_to(opacities, (len(opacities), 3))


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
