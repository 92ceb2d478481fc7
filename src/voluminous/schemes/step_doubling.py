"""Step doubling: a panel is solved as one and as two halves; the difference gives the error."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import any_attenuation, branch, precision_of
from ..backend.types import Float, Mask
from ..media.stretch import NODES
from .path import Path, last_argument, most, over
from .pre_integrated import solve_panel

if TYPE_CHECKING:
    from ..media.stretch import Panel, Stretch

# Optical depth above which only the front of a panel is visible, so that means over it say little.
_OPAQUE = 1.0
# Ratio of the halves' optical depths above which their difference says little about the deeper one.
_LOPSIDED = 4.0
# Error of such a half, as a fraction of its emission times its absorption: a source function that
# grows linearly from zero gives a sixth.
_WITHIN_HALF = 0.25
# Safety factor where structures are thinner than a panel. With 5, 99 % of rays through white noise
# are within their error, for any medium; with 2.5 (in 0.9 to 1 of the time) 98 %.
_SHARP = 5.0
# Rounding error of a panel and its halves, as a fraction of the panel's brightness.
_ROUNDING = {"single": 4e-6, "double": 1e-14}
# The error allowed in a piece of a ray is at least this fraction of the first piece's.
_LEAST = 0.2


@dataclass
class ErrorBudget:
    """Error allowed in a piece of a ray, given what lies in front of it along the walk.

    A piece may use a share of the remaining error of the pixel, so the sum stays below it for any
    number of pieces. With equal shares a tenth to a quarter of the pixels of colormaps in turbulent
    fields was drawn twice.

    Attributes
    ----------
    transparency : array
        The largest transparency in front; one where the walk goes towards the observer.
    used : array
        Error in front, as a fraction of the pixel's allowed error.
    """

    transparency: Float
    used: Float

    def accepts(self, source: Any, wrong: Float, dim: Float) -> tuple[Mask, Mask]:
        """Return where the errors of a piece's emission and transparency are accepted."""
        allowed, allowed_dim, _ = source.tolerance
        left = 1.0 - self.used
        left = dr.select(left > _LEAST, left, _LEAST)
        through = self.transparency
        return through * wrong <= left * allowed, through * dim <= left * allowed_dim

    def behind(self, source: Any, path: Path, backward: bool) -> ErrorBudget:
        """Return the budget behind a solved piece."""
        allowed, allowed_dim, share = source.tolerance
        wrong, dim, _ = path.error
        parts = wrong / allowed + dim / allowed_dim
        used = dr.fma(share * self.transparency, parts, self.used)
        through = self.transparency if backward else self.transparency * most(path.transparency)
        return ErrorBudget(through, used)


@dataclass
class Share:
    """One medium of a sum on a panel: its number of structures there, emission and depth."""

    count: Float
    bright: Float
    depth: Float


Halves = list[list[Share]]


def solve_with_error(
    source: Any, part: Stretch, budget: ErrorBudget, backward: bool, least: Mask
) -> tuple[Path, Mask]:
    """Return a solved panel, and where its error is accepted.

    The panel is solved as one and as two halves; where both are close the remaining difference is
    removed by extrapolation (Richardson 1911). Where `least` it cannot be halved again.
    """
    halves = [_solved(source, part.panel(a, b)) for a, b in pairwise(NODES)]
    fine = over(*(halves[::-1] if backward else halves))
    coarse = _solved(source, part.panel(0.0, 1.0))
    sharp = source.medium.sharpness(part, source.context)
    emission, wrong = _extrapolated(coarse.emission, fine.emission, *sharp)
    depth, _ = _extrapolated(coarse.depth, fine.depth, *sharp)
    through, dim = _extrapolated(
        [1.0 - theta for theta in coarse.transparency],
        [1.0 - theta for theta in fine.transparency],
        *sharp,
    )
    brightness = source.numbers.brightness
    parts = _in_parts(source, part, halves)
    doubtful = _crowded(parts[0]) | _crowded(parts[1])
    if not source.steady:
        doubtful |= (most(fine.depth) > _OPAQUE) | _lopsided(parts[0], parts[1])
    # In a branch, because few panels need it.
    unsure = branch(
        args=(halves, parts, least, halves[0].error[2] * 0.0),
        cond=doubtful,
        true_fn=functools.partial(_ordering_error, source, backward),
        false_fn=last_argument,
    )
    error = [brightness(wrong) + unsure, most(dim), brightness(emission)]
    # Extrapolation may give an absorption slightly above one.
    transparency = [dr.select(lost > 1.0, 0.0, 1.0 - lost) for lost in through]
    path = Path(emission, transparency, depth, error)
    # Smaller panels would not reduce an error that is due to rounding.
    rounding = _ROUNDING[precision_of(type(unsure))]
    good, good_dim = budget.accepts(source, *error[:2])
    good |= error[0] <= rounding * error[2]
    return path, good & (good_dim | (error[1] <= rounding))


def _ordering_error(
    source: Any, backward: bool, halves: list[Path], parts: Halves, least: Mask, zero: Float
) -> Float:
    """Return the error due to the unknown order of structures along the ray within a panel."""
    mixed = _mixed(parts)
    if source.steady:
        return mixed
    way = -1 if backward else 1
    hidden = _hidden_behind(source, halves[::way], parts[::way], least)
    return mixed + hidden + dr.select(least, 0.0, _in_one_half(halves, parts))


def _in_parts(source: Any, part: Stretch, halves: list[Path]) -> Halves:
    context = source.context
    counts = [one.cores(part, context) for one in source.medium.components()]
    return [
        [
            Share(count[h], bright, depth)
            for count, (bright, depth) in zip(
                counts, source.numbers.shares(half, part.panel(start, end), context), strict=True
            )
        ]
        for h, (half, (start, end)) in enumerate(zip(halves, pairwise(NODES), strict=True))
    ]


def _mixed(halves: Halves) -> Float:
    """Return the ordering error of panels with several structures: each may dim the others."""
    total: Float = 0.0
    for shares in halves:
        several = _crowded(shares)
        for k, share in enumerate(shares):
            own = dr.select(share.count > 1.5, _absorbed(share.depth), 0.0)
            others = [other.depth for other in shares[:k] + shares[k + 1 :]]
            if others:
                between = _absorbed(sum(others[1:], others[0]))
                own = own + dr.select(several, between, 0.0)
            total = total + 0.5 * share.bright * own
    return total


def _crowded(shares: list[Share]) -> Mask:
    return sum((share.count for share in shares[1:]), shares[0].count) > 1.5


def _absorbed(depth: Float) -> Float:
    return 1.0 - any_attenuation(depth)[0]


def _hidden_behind(source: Any, halves: list[Path], parts: Halves, least: Mask) -> Float:
    """Return the error of opaque panels, of which only the front (the first half) is visible.

    Agreement of the halves proves nothing then. Where panels cannot be narrower, the difference of
    the halves estimates the variation. Structures narrower than a panel do not count: see `_mixed`.
    """
    front, back = halves
    opaque = [_wide_depth(shares) > _OPAQUE for shares in parts]
    varies = []
    for c, (b, behind) in enumerate(zip(front.emission, back.emission, strict=True)):
        k = c if len(front.transparency) > 1 else 0
        lost, other = 1.0 - front.transparency[k], 1.0 - back.transparency[k]
        both = (lost > 0.0) & (other > 0.0)
        varies.append(dr.select(both, b - behind * (lost / dr.select(both, other, 1.0)), 0.0))
    narrow = dr.select(opaque[0], source.numbers.brightness(varies), 0.0)
    unsure = dr.select(opaque[0], front.error[2], 0.0)
    unsure = unsure + dr.select(opaque[1], back.error[2] * most(front.transparency), 0.0)
    return dr.select(least, narrow, 0.5 * unsure)


def _in_one_half(halves: list[Path], parts: Halves) -> Float:
    """Return the error of panels of which one half is nearly empty.

    The whole then equals the other half, and their agreement does not bound the variation in it.
    """
    total: Float = 0.0
    for half, shares, others in zip(halves, parts, parts[::-1], strict=True):
        own = half.error[2] * _absorbed(_wide_depth(shares))
        total = total + dr.select(_heavier(shares, others), own, 0.0)
    return _WITHIN_HALF * total


def _lopsided(first: list[Share], second: list[Share]) -> Mask:
    return _heavier(first, second) | _heavier(second, first)


def _heavier(shares: list[Share], others: list[Share]) -> Mask:
    return _wide_depth(shares) > _LOPSIDED * _wide_depth(others)


def _wide_depth(shares: list[Share]) -> Float:
    """Return the optical depth of all structures wider than a half; for the others see `_mixed`."""
    return sum(dr.select(share.count < 1.0, share.depth, 0.0) for share in shares)


def _extrapolated(
    coarse: list[Float], fine: list[Float], thin: Float, bent: Float
) -> tuple[list[Float], list[Float]]:
    """Return the limit of two second-order approximations, and its error.

    The error of the halves is a third of their difference from the whole; it is subtracted, and the
    whole difference is returned as the error. Where they differ much, or structures are thinner
    than a half, the order is lost: the halves are then returned, with more than the difference as
    error. `bent` is a relative error that both may share.
    """
    values, errors = [], []
    for c, f in zip(coarse, fine, strict=True):
        off, size = dr.abs(f - c), dr.abs(f)
        share = dr.select(off < 0.25 * size, (1.0 - thin) * (1 / 3), 0.0)
        values.append(dr.fma(f - c, share, f))
        errors.append(off * dr.fma(thin, _SHARP - 1.0, 1.0) + bent * size)
    return values, errors


def _solved(source: Any, panel: Panel) -> Path:
    path = solve_panel(source, panel)
    zero = type(panel.length)(0)
    path.error = [zero, zero, source.numbers.brightness(path.emission)]
    return path
