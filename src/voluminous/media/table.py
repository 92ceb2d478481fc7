"""Media given by tables: visibility on a ray segment, means, and errors that panels do not show."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.functions import precision_of
from ..backend.types import Float, Mask
from ..errors import InputError
from ..expressions import Expression
from ..expressions.expression import Monotonicity
from ..expressions.interval import Interval
from ..units import plain, unit_of
from .arguments import (
    given_colors,
    given_columns,
    given_path_length,
    given_values,
    length_in,
    named,
)
from .bound import Binding, BoundMedium
from .color_by import ColorBy
from .context import Context, Feature, Halves, MediumSample
from .contract import Medium
from .details import Colors
from .jumps import NOISE, Jump, passes
from .modulation import Modulation
from .panel import PLACES, Panel, extremes, kept, noise_of
from .piecewise_linear import PiecewiseLinear, Place, TableMiddles
from .shading import given_shade

if TYPE_CHECKING:
    from ..bounds.enclosure import EnclosedPanel, EnclosureContext, PanelBounds

# Structures are grouped in classes of width; ratio of one class to the next.
_CLASS, _CLASSES = 8.0, 3
# Most jumps for which crossings are searched, the largest first: each adds to every kernel.
_JUMPS = 4
# Control points that exceed the nodes by this part of a structure's width need smaller panels.
_DOUBT = 0.25
# Error of x by parabolas, as a part of its fourth difference: 1/360 where it is smooth, 0.05 of a
# root from its zero. Without it 5 to 60 % of pixels beside a vacuum were beyond their errors.
_TOLD_BY_FOURTH = 0.06
# Factor on that where x only just reaches a visible entry.
_REACHED = 2.0**-8


@dataclass
class _Parts:
    """Kernel constants: the range of x that may be noticeable, structures and jumps of a table.

    Of each structure, the narrowest first: the allowed unseen change of x, and its range of x.
    """

    first: Float
    last: Float
    ends: list[Float]
    structures: list[list[Float]]
    jumps: list[Float]


class Table(Medium):
    """Piecewise-linear colours and opacities; constant beyond both ends.

    Parameters
    ----------
    expr : str
        Expression x of the fields.
    values : array_like, shape (n,)
        Increasing values of x, at least two; two equal ones make a jump.
    colors : array_like, shape (n, channel) or (n,), sequence of str, or ColorBy
        Emission h_j at these values, or names of colours. With a `ColorBy`: the opacity times a
        colour by another expression.
    opacities : array_like, shape (n,), (n, channel) or a number
        Extinction h_α at these values.
    path_length : float, Quantity or "auto", default "auto"
        Length to which colours and opacities refer; ``"auto"`` as in `Gaussian`, for the total
        width of the opaque (or, if there are none, bright) entries in the volume's range of x.
    where : str, optional
        As in `Gaussian`.
    shading : float
        0 (default): none, as in radiative transfer. Up to 1: that part of the emission is
        proportional to the cosine between a light and the gradient of x; the rest is ambient. An
        illustration.
    lights : list, optional
        Of ``"headlight"`` (the default, a light at the camera), directions (x, y, z) towards a
        light, or pairs of one of these and its relative intensity.

    Raises
    ------
    InputError
        If shapes do not fit, values do not increase, opacities are negative, or a number is not
        finite.
    """

    modulation: Modulation

    def __init__(
        self,
        expr: Any,
        values: Any,
        colors: Any,
        opacities: Any,
        path_length: Any = "auto",
        *,
        where: Any = None,
        shading: float = 0.0,
        lights: Any = None,
    ) -> None:
        self.expr = Expression(expr)
        self.unit = unit_of(values)
        self.values = given_values(plain(values, self.unit, "values"))
        n = len(self.values)
        self.opacities = given_columns(opacities, n, "opacities")
        by = colors if isinstance(colors, ColorBy) else None
        self.colors = given_colors(colors, n) if by is None else _shared_colors(self.opacities, by)
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
        # All columns, those of the colours first, and each over its largest magnitude.
        self.rows = np.concatenate([self.colors, self.opacities], axis=1)
        largest = np.abs(self.rows).max(axis=0)
        self.peaks = np.where(largest > 0, largest, 1.0)
        self.shape = np.ascontiguousarray(self.rows / self.peaks)
        self.modulation = Modulation(
            where, by, self.channels, given_shade(self.expr, shading, lights)
        )
        self.sensitivity = self.modulation.sensitivity
        self.names = self.used_names()

    @property
    def color(self) -> tuple[float, ...]:
        """The brightest emission of each channel."""
        return tuple(np.abs(self.colors).max(axis=0).tolist())

    @property
    def opacity(self) -> tuple[float, ...]:
        """The largest extinction, or one for each channel."""
        return tuple(self.opacities.max(axis=0).tolist())

    def bind(self, binding: Binding) -> BoundMedium:
        return BoundTable(self, binding)

    def features(self) -> tuple[Feature, ...]:
        steps = np.diff(self.values)
        # Without structures there are only jumps: the width is 0.
        least = float(steps[steps > 0].min()) if np.any(steps > 0) else 0.0
        width = least if self.unit is None else least * self.unit
        scalar = Feature(self.expr, width, scalar=True, colors=self._scale())
        return (scalar, *self.modulation.features())

    def _scale(self) -> Colors:
        values = self.values if self.unit is None else self.values * self.unit
        return Colors(values, None if self.modulation.color else self.colors)

    def peak(self) -> tuple[float, float, float]:
        return float(self.colors.min()), float(self.colors.max()), float(self.opacities.max())

    def visible_key(self) -> Any:
        return (*self._entries(), self.modulation.gate_key())

    def profile(
        self, unit: Any, extent: Callable[[], tuple[float, float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        values = self.values
        if self.unit is not None:
            values = np.asarray(plain(values * self.unit, unit, "values"))
        heights = self.opacities.max(axis=1)
        if not heights.any():
            heights = np.abs(self.colors).max(axis=1)
        low, high = extent()
        if not low < high:  # one value everywhere: its surroundings do no harm
            low, high = min(low, values[0]), max(high, values[-1])
        inside = (values > low) & (values < high)
        ends = np.interp([low, high], values, heights)
        nodes = np.concatenate([[low], values[inside], [high]])
        return nodes, np.concatenate([ends[:1], heights[inside], ends[1:]])

    def key(self) -> Any:
        return (*self._entries(), named(self.path_length), self.modulation.key())

    def _entries(self) -> tuple[Any, ...]:
        data = (self.values.tobytes(), self.colors.tobytes(), self.opacities.tobytes())
        shapes = (self.colors.shape, self.opacities.shape, str(self.unit))
        return ("Table", self.expr.text, *data, *shapes)

    def describe(self) -> dict[str, Any]:
        numbers: list[float] = self.values.tolist()
        values = numbers if self.unit is None else [named(n * self.unit) for n in numbers]
        return {**super().describe(), "values": values}


class BoundTable(BoundMedium):
    """The numbers of a `Table`: the drawn columns, those of the colours first.

    Attributes
    ----------
    nodes : float array, shape (n,)
        Values of x in the unit of the expression.
    columns : float array, shape (n, column)
        Entries over their largest magnitude in each column.
    heights : float array, shape (column,)
        These magnitudes, in the kernel's units.
    """

    def __init__(self, medium: Table, binding: Binding) -> None:
        self.expr, self.modulation = medium.expr, medium.modulation.bind(binding)
        self.nodes, self._part = np.ascontiguousarray(medium.values), binding.part
        if medium.unit is not None:
            values = plain(medium.values * medium.unit, binding.unit_of(self.expr), "values")
            self.nodes = np.ascontiguousarray(values)
        drawn = np.arange(medium.channels)[binding.channels]
        self._emissions = len(drawn)
        drawn = np.append(drawn, medium.channels + (np.zeros(1, int) if medium.grey else drawn))
        units = [*binding.units(self._emissions), *[1.0] * (len(drawn) - self._emissions)]
        per_length = binding.length / length_in(medium.path_length, binding.unit)
        self.columns = medium.shape[:, drawn]
        self.heights = medium.peaks[drawn] / np.array(units) * per_length
        self._rows = medium.rows[:, drawn] * (per_length / np.array(units))

    def split(self, values: Sequence[Float]) -> MediumSample:
        """Return values of the columns as coefficients."""
        k = self._emissions
        return MediumSample([*values[:k]], [*values[k:]])

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        result = self.values(context.evaluate(self.expr, fields), context)
        return self.modulation.coefficients(result, fields, context)

    def values(self, x: Float, context: Context) -> MediumSample:
        """Return the entries at values of x, or intervals of them."""
        return self.split(context.interpolate(x, self.nodes, [*self._rows.T]))

    def may_show(self, ranges: dict[str, Interval], context: Context) -> Mask:
        x = context.evaluate(self.expr, ranges)
        seen: Any = x.nan
        for value in context.interpolate(x, self.nodes, list(self.columns.T)):
            seen = seen | (value.size > context.faint)
        return seen & self.modulation.may_show(ranges, context)

    def prominence(self, x: Float, context: Context) -> Float:
        """Return the largest entry at a value of x: steps may be wide where it is small."""
        (most,) = context.interpolate(x, self.nodes, [np.abs(self.columns).max(axis=1)])
        return most

    def jumps(self) -> list[Jump]:
        return self.modulation.jumps()

    def panel_bounds(self, panel: EnclosedPanel, context: EnclosureContext) -> list[PanelBounds]:
        heights = [context.number(float(h)) for h in self.heights]
        means = panel.table_means(self.expr, self.nodes, self.columns)
        scaled = self.split([h * mean for h, mean in zip(heights, means, strict=True)])
        values = self.values(panel.enclosure(self.expr).values, context)
        alphas = values.extinction * (self._emissions if len(values.extinction) == 1 else 1)
        sources = [j / a for j, a in zip(values.emissivity, alphas, strict=True)]
        modulated = self.modulation.panel_bounds
        return modulated(self, values.emissivity, scaled, sources, panel, context)

    # --- on panels ------------------------------------------------------------------------------

    def mean(self, panel: Panel) -> MediumSample:
        first, last = (self._place(panel, s) for s in (0.0, 1.0))
        table = self._table(panel.context, type(first.x))
        means = zip(self._numbers(panel.context), table.means(first, last), strict=False)
        sample = self.split([height * mean for height, mean in means])
        if self.modulation.fixed:
            return sample
        middles = self._middles(panel.context, table)
        return self.modulation.mean(sample, panel, middles.between(first, last))

    def halves(self, panel: Panel) -> Halves:
        """Return the means over both halves from parabolas through quarters."""
        places = [self._place(panel, s) for s in PLACES]
        a, b, c, d, e = (place.x for place in places)
        turns = [a - 2.0 * b + c, b - 2.0 * c + d, c - 2.0 * d + e]
        noise = 4.0 * noise_of(a, e)
        one, both, other = (dr.select(dr.abs(t) > noise, 0.5 * t, 0.0) for t in turns)
        bows = [1.5 * one - 0.5 * both, 0.5 * (one + both), 0.5 * (both + other)]
        bows.append(1.5 * other - 0.5 * both)
        missed = None  # of sums of fields, which are cubics: shaded skin took 1.04 of the time
        if self.expr.kind(("r", *panel.context.coordinates)) > Monotonicity.SUM:
            thirds = [after - before for before, after in pairwise(turns)]
            bent = dr.abs(thirds[1] - thirds[0])
            if not self.expr.smooth:  # fourth differences of two jumps may cancel
                bent = 2.0 * (dr.abs(thirds[0]) + dr.abs(thirds[1]))
            missed = dr.select(bent > 2.0 * noise, _TOLD_BY_FOURTH * bent, 0.0)
        table = self._table(panel.context, type(a))
        quarters = [
            table.bent_means(*ends, bow, missed)
            for ends, bow in zip(pairwise(places), bows, strict=True)
        ]
        found = []
        for height, *parts in zip(self._numbers(panel.context), *quarters, strict=False):
            means, errors = zip(*parts, strict=True)
            half, quarter = 0.5 * height, 0.25 * height
            error = quarter * (errors[0] + errors[1] + errors[2] + errors[3])
            found.append((half * (means[0] + means[1]), half * (means[2] + means[3]), error))
        result = Halves.of(self.split(found))
        if self.modulation.fixed:
            return result
        middles, ends = self._middles(panel.context, table), (places[:3:2], places[2::2])
        return self.modulation.halves(result, panel, [middles.between(*pair) for pair in ends])

    def _middles(self, context: Context, table: PiecewiseLinear) -> TableMiddles:
        return context.keep(
            (self._part, "middles"), lambda: TableMiddles(table.real, self.nodes, self._weight)
        )

    @property
    def _weight(self) -> np.ndarray:
        return np.asarray(np.abs(self.columns).mean(axis=1))

    def _table(self, context: Context, real: Any) -> PiecewiseLinear:
        def make() -> PiecewiseLinear:
            columns = self.columns
            if not self.modulation.fixed:
                columns = np.concatenate([columns, self._weight[:, None]], axis=1)
            return PiecewiseLinear(real, self.nodes, columns)

        return context.keep((self._part, "table"), make)

    def _place(self, panel: Panel, s: float) -> Place:
        def make() -> Place:
            x = panel.context.narrow(panel.scalar(self.expr, s))
            return self._table(panel.context, type(x)).at(x)

        return kept(panel, (id(self), s), make)

    def _numbers(self, context: Context) -> list[Float]:
        """Return the heights as kernel constants."""
        return context.keep(
            (self._part, "heights"), lambda: [context.narrow_number(float(h)) for h in self.heights]
        )

    def visible(self, panel: Panel) -> tuple[Mask, Mask]:
        """Return where an entry may be noticeable, and where a panel's ends may miss that."""
        context = panel.context
        low, high = (context.narrow(x) for x in panel.hull(self.expr))
        below, above = (context.narrow(x) for x in panel.range(self.expr))
        parts = self._kernel_numbers(context, type(low))
        seen = ~((low > parts.last) | (high < parts.first))  # where there is NaN, it must show
        # Between log10 of zero and a value there is all of the table, and ends show none of it.
        endless = dr.isinf(below) | dr.isinf(above)
        unresolved = seen & endless & (high > parts.ends[0]) & (low < parts.ends[1])
        for doubt, begin, end in parts.structures:
            unresolved |= (high > above + doubt) & (above < end) & (high > begin)
            unresolved |= (low < below - doubt) & (below > begin) & (low < end)
        if parts.structures:
            unresolved |= seen & self._entered(parts, panel)
        for edge in parts.jumps:
            # Any excess beyond a jump counts, however small.
            possible, shown = passes(panel, self.expr, edge)
            unresolved |= seen & (possible > shown)
        return self.modulation.visible(panel, seen, unresolved)

    def _kernel_numbers(self, context: Context, real: Any) -> _Parts:
        def make() -> _Parts:
            nodes, shape = self.nodes, self.columns
            opaque = functools.partial(dr.opaque, real)
            first, last = map(opaque, visible_range(nodes, shape, context.faint))
            rows = [(_DOUBT * w, *ends) for w, *ends in structures(nodes, shape)]
            return _Parts(
                first,
                last,
                ends=[opaque(float(nodes[k])) for k in (0, -1)],
                structures=[list(map(opaque, row)) for row in rows],
                jumps=[context.number(x) for x in jumps(nodes, shape)],
            )

        return context.keep((self._part, "parts"), make)

    def _entered(self, parts: _Parts, panel: Panel) -> Mask:
        """Return where x reaches visible entries, but neither end does.

        In an opaque table even a small excess matters.
        """
        low, high = panel.hull(self.expr)
        below, above = panel.range(self.expr)
        noise = NOISE[precision_of(type(low))] * extremes([dr.abs(low), dr.abs(high)])[1]
        least = _REACHED * parts.structures[0][0] + noise
        return ((above <= parts.first) & (high > parts.first + least)) | (
            (below >= parts.last) & (low < parts.last - least)
        )


def visible_range(nodes: np.ndarray, columns: np.ndarray, faint: float) -> tuple[float, float]:
    """Return the range of x in which an entry may exceed `faint`; (∞, -∞) if none does."""
    visible = np.flatnonzero((np.abs(columns) > faint).any(axis=1))
    if not len(visible):
        return np.inf, -np.inf
    places = np.concatenate([[-np.inf], nodes, [np.inf]])
    return float(places[visible[0]]), float(places[visible[-1] + 2])


def structures(nodes: np.ndarray, columns: np.ndarray) -> list[tuple[float, float, float]]:
    """Return width, least and greatest x of the table's structures, the narrowest first.

    The width of a piece between two nodes is the change of x, at its rate, per unit change of the
    entries; a jump at an end counts as change. Pieces of similar width form one structure, from the
    first to the last of them.
    """
    steps = np.diff(nodes)
    jumps = np.abs(np.diff(columns, axis=0)).max(axis=1)
    alone = np.where(steps > 0, 0.0, jumps)
    change = jumps + np.append(alone[1:], 0.0) + np.append(0.0, alone[:-1])
    some = (steps > 0) & (change > 0)
    width = steps[some] / change[some]
    low, high = nodes[:-1][some], nodes[1:][some]
    found: list[tuple[float, float, float]] = []
    while len(width) and len(found) < _CLASSES:
        least = float(width.min())
        near = width < _CLASS * least
        found.append((least, float(low[near].min()), float(high[near].max())))
        width, low, high = width[~near], low[~near], high[~near]
    return found


def jumps(nodes: np.ndarray, columns: np.ndarray) -> list[float]:
    """Return the x at which entries jump (two equal nodes), the largest jump first."""
    change = np.where(np.diff(nodes) > 0, 0.0, np.abs(np.diff(columns, axis=0)).max(axis=1))
    largest = np.argsort(-change, kind="stable")[:_JUMPS]
    return [float(nodes[k]) for k in largest if change[k] > 0]


def _shared_colors(opacities: np.ndarray, by: ColorBy) -> np.ndarray:
    if opacities.shape[1] not in (1, 3):
        raise InputError(f"opacities must have one column or 3, got {opacities.shape[1]}")
    return by.brightness * np.broadcast_to(opacities, (len(opacities), 3))
