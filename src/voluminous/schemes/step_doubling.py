"""Step doubling: a panel is solved as one and as two halves; the difference gives the error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import precision_of
from ..backend.types import Float, Mask
from .path import Path, most, over
from .pre_integrated import solve_panel

if TYPE_CHECKING:
    from ..media.panel import Panel

# Means converge with their order p: the error of the halves is their difference from the whole over
# 2^p - 1 (Richardson 1911), which is subtracted where the difference is below a part of the light.
_SUBTRACTED = {1: 0.0, 2: 1 / 3, 4: 1 / 15}
_CLOSE = 0.05
# What is told as the error, as a part of the difference: at first order (kinks and jumps), where
# structures are in one half only, and in steps of many cells, whose walls are kinks, the difference
# may be small by accident. Errors of panels have any sign and are added as such (`path`), so each
# of them counts with more than its likely size. More is told the larger the difference is.
_TOLD = {1: 3.0, 2: 0.3, 4: 0.45}
_TOLD_IF_THIN, _TOLD_IF_MANY, _TOLD_IF_FAR = 2.0, 2.0, 2.0
_MORE = 10.0
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


def solve_with_error(
    source: Any, whole: Panel, halves: list[Panel], backward: bool, many: Mask
) -> Path:
    """Return a panel solved as two halves, with the error that the whole panel tells.

    `halves` are in the order of the walk; `many` says where they are of many cells.
    """
    brightness = source.numbers.brightness
    solved = [_solved(source, half) for half in halves]
    front, back = solved[::-1] if backward else solved
    fine, coarse = over(front, back), _solved(source, whole)
    if not source.steady:
        more = _by_gradients(front, back)
        fine.emission = [dr.fma(d, 1 / 6, b) for b, d in zip(fine.emission, more, strict=True)]
        coarse.emission = [dr.fma(d, 2 / 3, b) for b, d in zip(coarse.emission, more, strict=True)]
    order = source.medium.order
    # Nearly one where one half has nearly all.
    thin = _uneven(front.error[2] + most(front.depth), back.error[2] + most(back.depth)) ** 4
    told = dr.select(many, _TOLD_IF_MANY, dr.fma(_TOLD_IF_THIN, thin * thin, _TOLD[order]))
    emission, wrong = _extrapolated(coarse.emission, fine.emission, order, told)
    through, dim = _extrapolated(coarse.transparency, fine.transparency, order, told)
    off = brightness(wrong)
    if not source.steady:
        off = off + _ordering_error(source, solved, halves) + _hidden_error(front, back)
    transparency = [dr.select(t > 0.0, dr.select(t < 1.0, t, 1.0), 0.0) for t in through]
    return Path(emission, transparency, fine.depth, [off, most(dim), brightness(emission)])


def _ordering_error(source: Any, solved: list[Path], halves: list[Panel]) -> Float:
    """Return the error due to the unknown order of structures along the ray within each half.

    If all of one structure is in front of the other it dims that by its absorption; means over a
    half dim it by half of that. Structures alike in both halves are resolved: gradients tell
    their order.
    """
    shares = [
        source.numbers.shares(path, panel, source.context)
        for path, panel in zip(solved, halves, strict=True)
    ]
    uneven = []
    for one, other in zip(*shares, strict=True):
        parts = [_uneven(a, b) for a, b in zip(one, other, strict=True)]
        uneven.append(dr.select(parts[0] > parts[1], *parts))
    found: Float = 0.0 * solved[0].error[0]
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


def _uneven(first: Float, last: Float) -> Float:
    """Return the difference of two positive numbers as a part of their sum."""
    total = first + last
    return dr.abs(first - last) / dr.select(total > 0.0, total, 1.0)


def _by_gradients(front: Path, back: Path) -> list[Float]:
    """Return b₁ τ₂ - b₂ τ₁ of two halves, by which means miss the order along the ray.

    With j and α linear along a piece of length L, ∫ j(s) (1 - ∫₀ˢ α ds') ds is, to first order in
    α, the value of the means plus L² (j₀ α₁ - j₁ α₀)/12: 2/3 of this for the whole, 1/6 for the
    sum of both halves.
    """
    found = []
    for c, (b, other) in enumerate(zip(front.emission, back.emission, strict=True)):
        k = c if len(front.depth) > 1 else 0
        thin = front.depth[k] + back.depth[k] < _THIN
        found.append(dr.select(thin, b * back.depth[k] - other * front.depth[k], 0.0))
    return found


def _extrapolated(
    coarse: list[Float], fine: list[Float], order: int, told: Float
) -> tuple[list[Float], list[Float]]:
    """Return the limit of two approximations, and its error."""
    values, errors = [], []
    for c, f in zip(coarse, fine, strict=True):
        off, size = dr.abs(f - c), dr.abs(f)
        close = off < _CLOSE * size
        values.append(dr.fma(f - c, dr.select(close, _SUBTRACTED[order], 0.0), f))
        part = dr.fma(_MORE, off / dr.select(close, size, 1.0), told)
        errors.append(off * dr.select(close, part, _TOLD_IF_FAR))
    return values, errors


def _solved(source: Any, panel: Panel) -> Path:
    path = solve_panel(source, panel)
    zero = type(panel.length)(0)
    path.error = [zero, zero, source.numbers.brightness(path.emission)]
    return path
