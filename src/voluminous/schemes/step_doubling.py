"""A panel solved as two halves; its error: that of the means, and of the order along the ray."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..backend import dr
from ..backend.functions import any_attenuation, precision_of
from ..backend.types import Float, Mask
from ..media.bound import integrated
from .base import FieldSource, JAlpha
from .channels import Channels, Tolerance
from .path import Path, PathError, most, over
from .pre_integrated import solve_means

if TYPE_CHECKING:
    from ..media.context import MediumSample
    from ..media.panel import Panel

# The error of the correction for the order of light and absorption along a panel, as a part of it:
# at any optical depth, and per optical depth.
_LEFT, _LEFT_IF_DENSE = 0.3, 1.0
# Means ignore the order of light and absorption along a panel. Their gradient corrects that up to
# this optical depth.
_THIN = 0.5
# Optical depth from which on means over a half say little about what is seen of it.
_OPAQUE = 0.7
# Transparency behind which nothing is seen, and the inverse is in range.
_INVISIBLE = 1e-30
# Rounding error of a panel and its halves, as a fraction of the panel's brightness.
_ROUNDING = {"single": 4e-6, "double": 1e-14}


@dataclass
class Limits:
    """The errors of emission and transparency that are allowed in a panel.

    `through` is the transparency of what lies in front of it, per extinction.
    """

    emission: Float
    transparency: Float
    through: list[Float]

    def times(self, factor: Float) -> Limits:
        return Limits(self.emission * factor, self.transparency * factor, self.through)

    def seen(self) -> list[Float]:
        """Return how much less is seen of each channel than of the clearest one.

        One channel of a spectrum may be opaque where another is clear: errors are those of what is
        seen. (A real disc in an opaque line took 500 times as long without.)
        """
        if len(self.through) == 1:
            return []
        whole = most(self.through)
        per_whole = 1.0 / dr.select(whole > _INVISIBLE, whole, 1.0)
        return [dr.detach(a * per_whole) for a in self.through]

    def accept(self, path: Path) -> Mask:
        """Return where the error of a solved panel is accepted.

        Smaller panels would not reduce an error that is due to rounding.
        """
        error = PathError(*path.error)
        rounding = _ROUNDING[precision_of(type(error.emission))]
        good = (error.emission <= self.emission) | (error.emission <= rounding * error.brightness)
        return good & ((error.transparency <= self.transparency) | (error.transparency <= rounding))


def solve_with_error(source: FieldSource, panel: Panel, seen: list[Float]) -> Path:
    """Return a panel solved as two halves, and its error.

    `seen` are factors on errors, one per extinction; none if they are one.
    """
    tolerance = source.tolerance.seen(seen) if seen else source.tolerance
    constant = source.channels.constant
    *means, off = source.channels.integrate(panel)
    solved = front, back = [_solved(tolerance, own, 0.5 * panel.length) for own in means]
    found = over(front, back)
    dims = [t * a * panel.length for t, a in zip(found.transparency, off[1], strict=True)]
    wrong = []
    for c, j in enumerate(off[0]):
        k = c if len(dims) > 1 else 0
        if constant == [True]:
            wrong.append(found.transparency[k] * j * panel.length)
        else:
            through = any_attenuation(found.depth[k])[1]
            wrong.append(dr.fma(found.emission[c] * off[1][k], through, j * through) * panel.length)
    if constant != [True]:
        shares = _shares(source.channels, tolerance, solved, panel)
        uneven = [
            [_most_uneven(*ends) for ends in zip(*halves, strict=True)]
            for halves in zip(*shares, strict=True)
        ]
        lopsided = [most(list(own)) for own in zip(*uneven, strict=True)]
        for c, (b, d) in enumerate(zip(found.emission, _by_gradients(front, back), strict=True)):
            k = c if len(found.depth) > 1 else 0
            depth = found.depth[k]
            share = dr.select(depth < _THIN, 1.0 - lopsided[k], 0.0)
            found.emission[c] = dr.fma(d, share, b)
            left = dr.fma(_LEFT_IF_DENSE, depth, _LEFT) + (1.0 - share)
            wrong[c] = dr.fma(dr.abs(d), left, wrong[c])
    error = tolerance.brightness(wrong)
    if constant != [True]:
        ordering, occluded = _ordering_error(constant, shares, uneven), _occluded(front, back)
        error = error + most(ordering) + tolerance.brightness(occluded)
        source_range = source.channels.bound.source_range(panel)
        if source_range is not None:
            # What is seen of an opaque panel is a mean of the source function, whatever the order;
            # more matter than was found would add what comes through.
            rows = zip(found.transparency, source_range.spread(), found.emission, strict=True)
            most_wrong = [
                dr.abs(b) * (s + theta / dr.select(theta < 1.0, 1.0 - theta, 1e-6))
                for theta, s, b in rows
            ]
            every = zip(
                *map(tolerance.bright, (wrong, occluded, most_wrong)), ordering, strict=True
            )
            error = most([dr.minimum(w + h + o, m) for w, h, m, o in every])
    if seen:
        dims = [d * w for d, w in zip(dims, seen, strict=True)]
    found.error = [error, most(dims), tolerance.brightness(found.emission)]
    return found


# The brightness and the optical depth of a part of a medium, per extinction.
Share = list[tuple[Float, Float]]


def _shares(
    channels: Channels, tolerance: Tolerance, solved: Sequence[Path], panel: Panel
) -> list[list[Share]]:
    """Return brightness and optical depth of each part on both halves, per extinction."""
    parts, grey = channels.bound.parts, channels.extinctions == 1
    if len(parts) > 1:
        found, length = [integrated(part, panel) for part in parts], 0.5 * panel.length
        return [
            [_share(tolerance, grey, half(one), length) for one in found]
            for half in (operator.attrgetter("first"), operator.attrgetter("last"))
        ]
    if grey:
        return [[[(path.error[2], path.depth[0])]] for path in solved]
    return [[list(zip(tolerance.bright(p.emission), p.depth, strict=True))] for p in solved]


def _share(tolerance: Tolerance, grey: bool, means: MediumSample, length: Float) -> Share:
    depths = [a * length for a in means.extinction]
    if grey:
        bright = [tolerance.brightness(means.emissivity)]
    else:
        bright = tolerance.bright(means.emissivity)
        depths = depths if len(depths) > 1 else depths * len(bright)
    rows = zip(bright, depths, strict=True)
    return [(b * length / dr.maximum(depth, dr.fma(0.5, depth, 1.0)), depth) for b, depth in rows]


def _ordering_error(
    constant: list[bool], shares: list[list[Share]], uneven: list[list[Float]]
) -> list[Float]:
    """Return the error due to the unknown order of structures along the ray within each half.

    If all of one structure is in front of the other it dims that by its absorption; means over a
    half dim it by half of that. Structures alike in both halves are resolved: gradients tell
    their order.
    """
    found = []
    for c in range(len(uneven[0])):
        total: Float = 0.0 * shares[0][0][c][0]
        for own in shares:
            for i, first in enumerate(own):
                for k, other in enumerate(own):
                    if i == k and constant[i]:
                        continue
                    (bright, _), (_, depth) = first[c], other[c]
                    one, two = uneven[i][c], uneven[k][c]
                    apart = dr.select(one > two, one, two)
                    lost = dr.select(depth < 1.0, depth, 1.0)
                    total = total + 0.5 * (apart * apart) * bright * lost
        found.append(total)
    return found


def _occluded(front: Path, back: Path) -> list[Float]:
    """Return the error of opaque halves: only the front of each is seen, and not resolved."""
    grey, sums = len(front.depth) == 1, []
    for c, (b, other) in enumerate(zip(front.emission, back.emission, strict=True)):
        k = 0 if grey else c
        own = dr.select(front.depth[k] > _OPAQUE, 0.5 * dr.abs(b), 0.0)
        behind = dr.select(back.depth[k] > _OPAQUE, 0.5 * dr.abs(other), 0.0)
        sums.append(dr.fma(front.transparency[k], behind, own))
    return sums


def _most_uneven(one: tuple[Float, Float], other: tuple[Float, Float]) -> Float:
    """Return how different both halves are in brightness or optical depth: 1 if only one has it."""
    found = []
    for a, b in zip(one, other, strict=True):
        found.append(dr.abs(a - b) / dr.select(a + b > 0.0, a + b, 1.0))
    return most(found)


def _by_gradients(front: Path, back: Path) -> list[Float]:
    """Return (b₁ τ₂ - b₂ τ₁)/6 of two halves, which means of each leave out.

    With j and α linear along a piece of length L, ∫ j(s) (1 - ∫₀ˢ α ds') ds is, to first order in
    α, the value of the means plus L² (j₀ α₁ - j₁ α₀)/12: 1/6 of this for the sum of both halves.
    """
    found = []
    for c, (b, other) in enumerate(zip(front.emission, back.emission, strict=True)):
        k = c if len(front.depth) > 1 else 0
        found.append((b * back.depth[k] - other * front.depth[k]) * (1 / 6))
    return found


def _solved(tolerance: Tolerance, means: JAlpha, length: Float) -> Path:
    path = solve_means(means, length)
    zero = type(length)(0)
    path.error = [zero, zero, tolerance.brightness(path.emission)]
    return path
