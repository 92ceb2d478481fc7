"""Post-classified: fields are interpolated along the ray, and the medium is evaluated there.

Between cell centres a field is trilinear, so it is a cubic along a segment. Where the medium is
smooth along a whole segment, four samples give its integral and a bound of the error. Elsewhere the
segment is cut into panels with adaptive widths that end at the edges (discontinuities) of the
medium. A panel is solved with more samples, or in closed form (`Medium.means`) with the medium's
scalars nearly linear on it, and step doubling (`step_doubling`). The closed form is used where the
medium is not smooth, where only the front of a panel is visible, where its scalars are linear (the
closed form is then exact), and where there were too many panels.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import THIN, branch, precision_of, records, thin_attenuation
from ..backend.types import Float, Mask
from ..grids.contract import Segment
from ..media.edges import edges_ahead, first_edge
from .base import Position, Scheme, Solution
from .path import Path, empty_path, last_argument, most, over
from .step_doubling import ErrorBudget, solve_with_error

if TYPE_CHECKING:
    from ..media.stretch import Stretch

# The fields along a segment as polynomials; the scalars at positions on it, both ends included.
Polynomials = dict[str, list[Float]]
Values = list[list[Float]]

# Panels are not narrower than this fraction of a segment. With 2^-8 in single precision, three
# surfaces of noise in a 500th of a cell had errors of 0.1 of the maximum, in more time; where
# panels at jumps of gates stopped there, in 0.7 of the time, 4 to 28 % of pixels exceeded their
# error.
_NARROWEST = 2.0**-14
# A panel this narrow that evaluates to NaN will not improve by halving: with a negative extinction
# pictures of 20 x 20 pixels took minutes until they were refused.
_NOT_FINITE = 2.0**-4
# Scalars are linear along a segment if their slope changes by less than this fraction.
_STRAIGHT = 0.01
# Shells thinner than this fraction of a segment are not sampled; closed forms have no minimum
# width. With samples, shells of noise as wide as a third to a thirtieth of a cell take a half to a
# quarter of the time.
_SAMPLED = 2.0**-6
# Segments with a larger optical depth are not sampled: samples assume the attenuation of thin
# panels.
_DENSE = 2.0
# A panel ends this far behind an edge, as a fraction of the segment: more than its rounding error.
# With 2^-16 in single precision shells behind gates had errors of up to 1e-4 of the maximum.
_BEHIND = {"single": 2.0**-20, "double": 2.0**-32}


class PostClassified(Scheme):
    """Classify interpolated fields, to a tolerance."""

    name = "post-classified"
    order = 2
    coefficients_at = "field"
    controlled = True

    def start(self, position: Position, source: Any) -> list[Float]:
        """Carry the scalars at the ray's position (NaN: not computed yet), and the error budget."""
        unknown = source.context.real(math.nan)
        real = source.backend.Float
        return [*(unknown for _ in source.scalars), real(1), real(0)]

    def after_skip(
        self, position: Position, source: Any, carried: list[Float], moved: Mask
    ) -> list[Float]:
        *scalars, through, used = carried
        return [*(dr.select(moved, math.nan, x) for x in scalars), through, used]

    def after_hidden(self, carried: list[Float], onward: list[Float]) -> list[Float]:
        """Continue with the scalars after the hidden segment, and the budget before it."""
        return [*onward[:-2], *carried[-2:]]

    def solve(
        self, segment: Segment, source: Any, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        *scalars, through, used = carried
        budget = dr.detach(ErrorBudget(through, used))  # what is accepted has no derivative
        cubics = source.along(segment).polynomials()
        # First a rough estimate, which restricts the rest to visible segments: a shell in the
        # radius takes a sixth of the time.
        whole = source.stretch(cubics, segment.length, rough=True)
        for expr, before in zip(source.scalars, scalars, strict=True):
            fresh = whole.scalar(expr, 0.0)
            whole.set_scalar(expr, 0.0, dr.select(dr.isnan(before), fresh, before))
        visible, _ = source.medium.visible(whole, source.context)
        values = [whole.controls(expr) for expr in source.scalars]
        numbers = source.numbers
        nothing = empty_path(source.backend.Float, numbers.emissions, numbers.extinctions, 3)
        path = branch(
            args=(cubics, values, segment.length, budget, nothing),
            cond=visible & segment.active,
            true_fn=functools.partial(_visible, source, segment.backward),
            false_fn=last_argument,
        )
        budget = budget.behind(source, path, segment.backward)
        after = [
            dr.select(segment.active, ends[-1], before)
            for ends, before in zip(values, scalars, strict=True)
        ]
        return path, [*after, budget.transparency, budget.used]


def _visible(
    source: Any,
    backward: bool,
    cubics: Polynomials,
    values: Values,
    length: Float,
    budget: ErrorBudget,
    nothing: Path,
) -> Path:
    """Return a segment solved at once, or in panels where that is not accurate enough."""
    with source.recording():
        found, good, widest = _as_one(source, backward, cubics, values, length, budget, nothing)
    source.accept(nothing, found, good)
    solved: Path = branch(
        args=(cubics, values, length, budget, nothing, found),
        cond=good,
        true_fn=last_argument,
        false_fn=functools.partial(_in_panels, source, backward, widest),
    )
    return solved


def _as_one(
    source: Any,
    backward: bool,
    cubics: Polynomials,
    values: Values,
    length: Float,
    budget: ErrorBudget,
    nothing: Path,
) -> tuple[Path, Mask, float]:
    """Return a segment solved at once, where that is accurate enough, and the widest panel else."""
    whole = _stretch(source, cubics, values, length, rough=source.smooth)
    if source.smooth:
        found, good = sampled_segment(source, whole, budget, backward)
        widest = 1.0 if source.quick else 0.5
    elif source.hollow:
        found, good = _surface_alone(source, whole, cubics, values, length, nothing)
        widest = 1.0
    elif source.edges and source.finer:  # how dense it is
        found, _ = sampled_segment(source, whole, budget, backward)
        good, widest = length < 0.0, 1.0
    else:
        found, good = solve_with_error(source, whole, budget, backward, length < 0.0)
        _, hidden = source.medium.visible(whole, source.context)
        good &= ~hidden
        widest = 0.5
        if source.edges:
            count, _ = edges_ahead(whole, source.edges)
            good, widest = good & (count == 0), 1.0
    return found, good, widest


def _stretch(
    source: Any, cubics: Polynomials, values: Values, length: Float, *, rough: bool = False
) -> Stretch:
    """Return a segment's stretch with the scalars that were computed outside of a branch."""
    whole: Stretch = source.stretch(cubics, length, rough=rough)
    if not records(length):  # scalars that were computed outside have no derivatives
        for expr, own in zip(source.scalars, values, strict=True):
            whole.set_controls(expr, own)
    return whole


# --- one rule for smooth segments -----------------------------------------------------------------


def sampled_segment(
    source: Any, whole: Stretch, budget: ErrorBudget, backward: bool, *, fine: bool = False
) -> tuple[Path, Mask]:
    """Return a segment solved with means of samples (more with `fine`), and where it is accepted.

    Where shells are wider than cells most segments need no panels, and take a quarter of the time
    of comparing three panels.
    """
    (emissivity, extinction), first, last, (off, off_depth) = source.sampled(whole, fine=fine)
    length, brightness = whole.length, source.numbers.brightness
    depth = [a * length for a in extinction]
    found = [thin_attenuation(tau) for tau in depth]
    emission = [j * length * found[c if len(found) > 1 else 0][1] for c, j in enumerate(emissivity)]
    dim = most(off_depth) * length
    wrong = brightness(off) * length
    if not source.steady:
        order = _ordering(first, last, -length if backward else length, length)
        emission = [b + more for b, more in zip(emission, order, strict=True)]
        wrong = dr.fma(0.5, brightness(order), wrong)
    bright = brightness(emission)
    wrong = dr.fma(0.5 * dim, bright, wrong)
    good, good_dim = budget.accepts(source, wrong, dim)
    path = Path(emission, [theta for theta, _ in found], depth, [wrong, dim, bright])
    return path, good & good_dim & (most(depth) <= THIN)


def _ordering(first: Float, last: Float, ahead: Float, length: Float) -> list[Float]:
    """Return what means miss by ignoring the order along the ray, with j and α linear.

    To first order in α, ∫ j(s) (1 - ∫₀ˢ α ds') ds is the value of the means plus L² (j₀ α₁ - j₁
    α₀)/12.
    """
    (j_first, a_first), (j_last, a_last) = first, last
    factor = ahead * length * (1.0 / 12.0)
    ks = [c if len(a_first) > 1 else 0 for c in range(len(j_first))]
    return [
        factor * (j0 * a_last[k] - j1 * a_first[k])
        for k, j0, j1 in zip(ks, j_first, j_last, strict=True)
    ]


# --- panels ---------------------------------------------------------------------------------------


@dataclass
class SubPanel:
    """A panel of a segment, with the segment's fields as polynomials and its length.

    Attributes
    ----------
    begin, width : array
        As fractions of the segment.
    scalars : list of pairs of arrays
        The medium's scalars at both ends of the panel.
    """

    cubics: Polynomials
    length: Float
    begin: Float
    width: Float
    scalars: Values

    def stretch(self, source: Any, *, edgeless: bool = True) -> Stretch:
        """Return the panel as a stretch; the medium decides whether edges may be inside."""
        part = self._part(source)
        part.edgeless = edgeless and bool(source.edges)
        if records(self.length):  # scalars are computed again: those of a loop have no derivatives
            return part
        for expr, (first, last) in zip(source.scalars, self.scalars, strict=True):
            part.set_scalar(expr, 0.0, first)
            part.set_scalar(expr, 1.0, last)
        return part

    def ending(self, source: Any, values: Values) -> SubPanel:
        """Return the panel with the scalars at its end.

        At the end of the segment they equal the next segment's to the last bit; otherwise a
        crossing could be counted twice.
        """
        part, last = self._part(source), self.begin + self.width >= 1.0
        ends = [
            dr.select(last, own[-1], part.scalar(expr, 1.0))
            for expr, own in zip(source.scalars, values, strict=True)
        ]
        pairs = [[first, end] for (first, _), end in zip(self.scalars, ends, strict=True)]
        return replace(self, scalars=pairs)

    def _part(self, source: Any) -> Stretch:
        whole: Stretch = source.stretch(self.cubics, self.length)
        return whole.part(self.begin, self.width)


def next_panel(good: Mask, begin: Float, width: Float, tried: Float) -> tuple[Float, Float]:
    """Return beginning and width of the next panel, as fractions of the segment.

    After an accepted panel the width is doubled, if there is room; a rejected panel is halved. If
    an edge made the panel narrower than `tried`, the next panel has at least that width.
    """
    begin = dr.select(good, begin + width, begin)
    wider = dr.select(2.0 * width > tried, 2.0 * width, tried)
    width = dr.select(good, wider, 0.5 * width)
    return begin, dr.select(width < 1.0 - begin, width, 1.0 - begin)


@dataclass
class PanelState:
    """The state of the loop over panels of one segment."""

    begin: Float
    width: Float
    scalars: list[Float]
    path: Path


def _in_panels(
    source: Any,
    backward: bool,
    widest: float,
    cubics: Polynomials,
    values: Values,
    length: Float,
    budget: ErrorBudget,
    nothing: Path,
    found: Path,
) -> Path:
    """Return a segment solved in panels; `widest` is the largest width of the first one."""
    real = type(length)
    closed = most(found.depth) > _DENSE
    if source.linear:
        closed |= _straight(source, cubics, values, length)

    segment = cubics, values, length
    # Dr.Jit 1.5 loses the derivatives of what a loop in a loop uses besides its arguments.
    arguments = segment if records(length) else ()

    def going_on(state: PanelState, *_: Any) -> Mask:
        return state.begin < 1.0

    def step(state: PanelState, *own: Any) -> tuple[Any, ...]:
        cubics, values, length = own or segment
        pairs = [[value, value] for value in state.scalars]
        with source.recording():
            panel = SubPanel(cubics, length, state.begin, state.width, pairs)
            panel = panel.ending(source, values)
            panel, passed, hidden = _up_to_edge(source, panel, values)
            left = budget.behind(source, state.path, backward)
            found, good = _solve_panel(source, backward, panel, left, closed)
            good &= ~hidden | (panel.width <= _NARROWEST)
            found = _with_layer(source, backward, panel, good & passed, found)
        source.accept(state.path, found, good)
        front, back = (found, state.path) if backward else (state.path, found)
        place = next_panel(good, state.begin, panel.width, state.width)
        scalars = [dr.select(good, end, start) for start, end in panel.scalars]
        path = dr.select(good, over(front, back), state.path)
        return PanelState(*place, scalars, path), *own

    state = PanelState(real(0), real(widest), [own[0] for own in values], nothing)
    end: PanelState
    end, *_ = dr.while_loop((state, *arguments), going_on, step, label="panels")
    return end.path


def _straight(source: Any, cubics: Polynomials, values: Values, length: Float) -> Mask:
    whole = _stretch(source, cubics, values, length, rough=True)
    straight = length >= 0.0
    for expr in source.scalars:
        slope, bend, _ = whole.derivatives(expr)
        straight &= bend <= _STRAIGHT * slope
    return straight


def _solve_panel(
    source: Any, backward: bool, panel: SubPanel, budget: ErrorBudget, closed: Mask
) -> tuple[Path, Mask]:
    if source.hollow:
        numbers = source.numbers
        nothing = empty_path(type(panel.length), numbers.emissions, numbers.extinctions, 3)
        return nothing, panel.width > 0.0

    def sampled(panel: SubPanel, budget: ErrorBudget) -> tuple[Path, Mask]:
        return sampled_segment(source, panel.stretch(source), budget, backward, fine=True)

    def compared(panel: SubPanel, budget: ErrorBudget) -> tuple[Path, Mask]:
        part, least = panel.stretch(source), panel.width <= _NARROWEST
        path, good = solve_with_error(source, part, budget, backward, least)
        _, hidden = source.medium.visible(part, source.context)
        not_finite = dr.isnan(path.error[0] + path.error[1]) & (panel.width <= _NOT_FINITE)
        return path, (good & ~hidden) | least | not_finite

    if not source.finer:
        return compared(panel, budget)
    return branch((panel, budget), closed | (panel.width < _SAMPLED), compared, sampled)


# --- edges of the medium, and surfaces without width ----------------------------------------------


def _surface_alone(
    source: Any,
    whole: Stretch,
    cubics: Polynomials,
    values: Values,
    length: Float,
    nothing: Path,
) -> tuple[Path, Mask]:
    """Return a segment of zero-width surfaces alone, and where it has at most one of them."""
    count, hidden = edges_ahead(whole, source.edges)
    good = ~hidden & (count < 2)
    real = type(length)
    panel = SubPanel(cubics, length, real(0), real(1), [[v[0], v[-1]] for v in values])
    return _with_layer(source, False, panel, good & (count > 0), nothing), good


Cut = tuple[SubPanel, Mask, Mask]


def _up_to_edge(source: Any, panel: SubPanel, values: Values) -> Cut:
    """Return a panel cut at its first visible edge, where there is one, and where some may hide.

    It ends just behind the edge; the next panel begins on the other side.
    """
    nowhere = panel.width < 0.0
    if not source.edges:
        return panel, nowhere, nowhere
    visible = ~nowhere
    if not source.hollow:
        visible, _ = source.medium.visible(panel.stretch(source, edgeless=False), source.context)

    def cut(values: Values, panel: SubPanel) -> SubPanel:
        place = first_edge(panel.stretch(source, edgeless=False), source.edges)
        end = dr.fma(place, panel.width, _BEHIND[precision_of(type(place))])
        width = dr.select(end < panel.width, end, panel.width)
        return replace(panel, width=width).ending(source, values)

    def to_first_edge(values: Values, uncut: Cut) -> Cut:
        count, hidden = edges_ahead(uncut[0].stretch(source, edgeless=False), source.edges)
        # A zero-width surface that is alone in a panel need not be at its end.
        several = count > (1 if source.hollow else 0)
        panel = branch((values, uncut[0]), several, cut, last_argument)
        return panel, count > 0, hidden

    shorter: Cut = branch(
        (values, (panel, nowhere, nowhere)), visible, to_first_edge, last_argument
    )
    return shorter


def _with_layer(source: Any, backward: bool, panel: SubPanel, passed: Mask, solved: Path) -> Path:
    """Return a panel with the zero-width surfaces at its end, where it passes one."""
    if not source.layered:
        return solved

    def layered(panel: SubPanel, solved: Path) -> Path:
        stretch, place = panel.stretch(source), 1.0
        if source.hollow and source.looks_inside:
            place = first_edge(stretch, source.edges)
        layer: Path = source.layer(stretch, place)
        zero = panel.length * 0.0
        layer.error = [zero, zero, source.numbers.brightness(layer.emission)]
        return over(layer, solved) if backward else over(solved, layer)

    result: Path = branch((panel, solved), passed, layered, last_argument)
    return result
