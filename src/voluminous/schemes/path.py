"""Stretches of rays as pairs (b, θ), and their composition: (b₁, θ₁) over (b₂, θ₂)."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ..backend import dr
from ..backend.functions import any_attenuation
from ..backend.types import Float


@dataclass
class Path:
    """Emission and transparency of a stretch of ray: of one segment, or accumulated so far.

    Attributes
    ----------
    emission : list of arrays
        b per channel (or per shape).
    transparency, depth : list of arrays
        θ and τ per extinction.
    error : list of arrays
        Empty, or those of a `PathError`.
    """

    emission: list[Float]
    transparency: list[Float]
    depth: list[Float]
    error: list[Float] = field(default_factory=list)


class PathError(NamedTuple):
    """The errors of b and θ, and the brightness of b, to which rounding is relative."""

    emission: Any
    transparency: Any
    brightness: Any


def empty_path(real: Float, channels: int, extinctions: int, errors: int = 0) -> Path:
    """Return the identity of composition: nothing emitted, everything transmitted."""
    return Path(
        [real(0) for _ in range(channels)],
        [real(1) for _ in range(extinctions)],
        [real(0) for _ in range(extinctions)],
        [real(0) for _ in range(errors)],
    )


def layer(emission: list[Float], depth: list[Float]) -> Path:
    """Return a layer of zero width from its optically thin emission and its optical depth."""
    found = [any_attenuation(tau) for tau in depth]
    grey = len(found) == 1
    seen = [b * found[0 if grey else c][1] for c, b in enumerate(emission)]
    return Path(seen, [theta for theta, _ in found], depth)


def over(front: Path, back: Path) -> Path:
    """Return ``front over back``: (b₁ + θ₁ b₂, θ₁ θ₂).

    It is associative, so tiles, chunks and both directions of the loop can compose in any grouping.
    """
    grey = len(front.transparency) == 1
    emission = [
        dr.fma(front.transparency[0 if grey else c], b, f)
        for c, (f, b) in enumerate(zip(front.emission, back.emission, strict=True))
    ]
    transparency = [f * b for f, b in zip(front.transparency, back.transparency, strict=True)]
    depth = [f + b for f, b in zip(front.depth, back.depth, strict=True)]
    return Path(emission, transparency, depth, _error_over(front, back))


def _error_over(front: Path, back: Path) -> list[Float]:
    """Return the errors of ``front over back``.

    δb = δb₁ + θ₁ δb₂ + δθ₁ b₂ and δθ = δθ₁ θ₂ + θ₁ δθ₂, with the brightness for b and the largest
    transparency for θ. Those of b have any sign: the root of the sum of their squares is taken.
    """
    if not front.error:
        return []
    first, last = PathError(*front.error), PathError(*back.error)
    through = most(front.transparency)
    emission = _hypotenuse(first.emission, through * last.emission)
    return [
        dr.fma(first.transparency, last.brightness, emission),
        dr.fma(through, last.transparency, first.transparency * most(back.transparency)),
        dr.fma(through, last.brightness, first.brightness),
    ]


def _hypotenuse(a: Float, b: Float) -> Float:
    large = dr.select(a > b, a, b)
    ratio = dr.select(a > b, b, a) / dr.select(large > 0.0, large, 1.0)
    return large * dr.sqrt(dr.fma(ratio, ratio, 1.0))


def most(values: list[Float]) -> Float:
    """Return the largest of some arrays."""
    return functools.reduce(lambda a, b: dr.select(a > b, a, b), values)


def last_argument(*arguments: Any) -> Any:
    """Return the last argument, unchanged: an argument of `branch`."""
    return arguments[-1]
