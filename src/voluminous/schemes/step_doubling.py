"""A panel solved as two halves; its error: that of the means, and of the order along the ray."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import any_attenuation, precision_of
from ..backend.types import Float, Mask
from .base import Coefficients
from .path import Path, most, over
from .pre_integrated import solve_means

if TYPE_CHECKING:
    from ..media.panel import Panel

# The error of the correction for the order of light and absorption along a panel, as a part of it:
# at any optical depth, and per optical depth.
_TOLD_BY_ORDER, _TOLD_IF_DENSE = 0.3, 1.0
# Means ignore the order of light and absorption along a panel. Their gradient tells what that is
# worth, up to this optical depth.
_THIN = 0.5
# Optical depth from which on means over a half say little about what is seen of it.
_OPAQUE = 0.7
# Rounding error of a panel and its halves, as a fraction of the panel's brightness.
_ROUNDING = {"single": 4e-6, "double": 1e-14}


@dataclass
class Limits:
    """The errors of emission and transparency that are allowed in a panel."""

    emission: Float
    transparency: Float

    def times(self, factor: Float) -> Limits:
        return Limits(self.emission * factor, self.transparency * factor)

    def accept(self, path: Path) -> Mask:
        """Return where the error of a solved panel is accepted.

        Smaller panels would not reduce an error that is due to rounding.
        """
        wrong, dim, bright = path.error
        rounding = _ROUNDING[precision_of(type(wrong))]
        good = (wrong <= self.emission) | (wrong <= rounding * bright)
        return good & ((dim <= self.transparency) | (dim <= rounding))


def solve_with_error(source: Any, panel: Panel, backward: bool) -> Path:
    """Return a panel solved as two halves, which are in the order of the walk, and its error."""
    brightness = source.numbers.brightness
    *means, off = source.integrate(panel)
    solved = [_solved(source, own, 0.5 * panel.length) for own in means]
    front, back = solved[::-1] if backward else solved
    found = over(front, back)
    dims = [t * a * panel.length for t, a in zip(found.transparency, off[1], strict=True)]
    wrong = []
    for c, j in enumerate(off[0]):
        k = c if len(dims) > 1 else 0
        if source.steady:
            wrong.append(found.transparency[k] * j * panel.length)
        else:
            seen = any_attenuation(found.depth[k])[1]
            wrong.append(dr.fma(found.emission[c] * off[1][k], seen, j * seen) * panel.length)
    if not source.steady:
        shares = source.numbers.shares(solved, panel, source.context)
        uneven = [_most_uneven(one, other) for one, other in zip(*shares, strict=True)]
        lopsided = most(uneven)
        for c, (b, d) in enumerate(zip(found.emission, _by_gradients(front, back), strict=True)):
            depth = found.depth[c if len(dims) > 1 else 0]
            known = dr.select(depth < _THIN, 1.0 - lopsided, 0.0)
            found.emission[c] = dr.fma(d, known, b)
            told = dr.fma(_TOLD_IF_DENSE, depth, _TOLD_BY_ORDER) + (1.0 - known)
            wrong[c] = dr.fma(dr.abs(d), told, wrong[c])
    error = brightness(wrong)
    if not source.steady:
        error = error + _ordering_error(source, shares, uneven) + _hidden_error(front, back)
    found.error = [error, most(dims), brightness(found.emission)]
    return found


def _ordering_error(
    source: Any, shares: list[list[tuple[Float, Float]]], uneven: list[Float]
) -> Float:
    """Return the error due to the unknown order of structures along the ray within each half.

    If all of one structure is in front of the other it dims that by its absorption; means over a
    half dim it by half of that. Structures alike in both halves are resolved: gradients tell
    their order.
    """
    found: Float = 0.0 * shares[0][0][0]
    for own in shares:
        for i, (bright, _) in enumerate(own):
            for k, (_, depth) in enumerate(own):
                if i == k and source.alike[i]:
                    continue
                apart = dr.select(uneven[i] > uneven[k], uneven[i], uneven[k])
                lost = dr.select(depth < 1.0, depth, 1.0)
                found = found + 0.5 * (apart * apart) * bright * lost
    return found


def _hidden_error(front: Path, back: Path) -> Float:
    """Return the error of opaque halves: only the front of each is seen, and not resolved."""
    own, other = (
        dr.select(most(half.depth) > _OPAQUE, 0.5 * half.error[2], 0.0) for half in (front, back)
    )
    return dr.fma(most(front.transparency), other, own)


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


def _solved(source: Any, means: Coefficients, length: Float) -> Path:
    path = solve_means(means, length)
    zero = type(length)(0)
    path.error = [zero, zero, source.numbers.brightness(path.emission)]
    return path
