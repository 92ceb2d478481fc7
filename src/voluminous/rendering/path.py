"""A stretch of ray is a pair (b, θ); two stretches compose: (b₁, θ₁) over (b₂, θ₂)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..backend import dr


@dataclass
class Path:
    """What a ray has gathered: emission per channel, transparency and depth per extinction."""

    emission: list[Any]
    transparency: list[Any]
    depth: list[Any]


def empty_path(real: Any, channels: int, extinctions: int) -> Path:
    """Return the identity of composition: nothing emitted, everything transmitted."""
    return Path(
        [real(0) for _ in range(channels)],
        [real(1) for _ in range(extinctions)],
        [real(0) for _ in range(extinctions)],
    )


def over(front: Any, back: Any) -> Path:
    """Return ``front over back``: (b₁ + θ₁ b₂, θ₁ θ₂); either may be a Path or a Solution.

    Associative, so tiles, chunks and both directions of the loop fold it as they like.
    """
    grey = len(front.transparency) == 1
    emission = [
        dr.fma(front.transparency[0 if grey else c], b, f)
        for c, (f, b) in enumerate(zip(front.emission, back.emission, strict=True))
    ]
    transparency = [f * b for f, b in zip(front.transparency, back.transparency, strict=True)]
    depth = [f + b for f, b in zip(front.depth, back.depth, strict=True)]
    return Path(emission, transparency, depth)
