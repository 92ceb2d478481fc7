"""Pairs (b, θ) on the host: one per stretch of a ray, folded for many pixels at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass
class Pairs:
    """Stretches of rays, in double precision.

    Attributes
    ----------
    emission : array, shape (n, channel)
    transparency : array, shape (n, channel or 1)
    error : array, shape (n, 3) or (n, 0)
        How far b may be off, how far θ may be off, and the brightness of b; or nothing is known.
    """

    emission: np.ndarray
    transparency: np.ndarray
    error: np.ndarray

    def over(self, back: Pairs) -> Pairs:
        """Return each of these in front of one of the others, as `schemes.path.over` does."""
        return Pairs(
            self.emission + self.transparency * back.emission,
            self.transparency * back.transparency,
            self._errors(back) if self.error.size else self.error,
        )

    def _errors(self, back: Pairs) -> np.ndarray:
        wrong, dim, bright = self.error.T
        wrong_back, dim_back, bright_back = back.error.T
        through = self.transparency.max(axis=1)
        error = [
            wrong + through * wrong_back + dim * bright_back,
            dim * back.transparency.max(axis=1) + through * dim_back,
            bright + through * bright_back,
        ]
        return np.stack(error, axis=1)

    def some(self, index: Any) -> Pairs:
        """Return some of them."""
        return Pairs(*(part.take(index, axis=0) for part in self.parts))

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Emission, transparency and error."""
        return self.emission, self.transparency, self.error

    @classmethod
    def mean(cls, found: list[Pairs]) -> Pairs:
        """Return the means of several sets."""
        if len(found) == 1:
            return found[0]
        return cls(
            *(np.mean(parts, axis=0) for parts in zip(*(one.parts for one in found), strict=True))
        )


def fold(pairs: Pairs, count: np.ndarray) -> Pairs:
    """Return one pair per group: all of it, the first one in front.

    Folding is associative: neighbours are joined in each round, so that there are few rounds,
    however many pairs one pixel has.

    Parameters
    ----------
    pairs : Pairs
        Group after group.
    count : int array
        How many pairs each group has, at least one.
    """
    count = np.asarray(count)
    several = np.flatnonzero(count > 1)
    if not len(several):
        return pairs
    start = np.cumsum(count) - count
    found = pairs.some(start)
    more = np.repeat(count > 1, count)
    joined = _joined(pairs.some(np.flatnonzero(more)), count[several])
    for part, whole in zip(found.parts, joined.parts, strict=True):
        part[several] = whole
    return found


def _joined(pairs: Pairs, count: np.ndarray) -> Pairs:
    while np.any(count > 1):
        start = np.cumsum(count) - count
        place = np.arange(int(count.sum())) - np.repeat(start, count)
        front = place % 2 == 0
        alone = front & (place == np.repeat(count, count) - 1)
        joined = pairs.some(np.flatnonzero(front))
        partner = np.flatnonzero(front & ~alone)
        where = np.flatnonzero(~alone[front])
        both = pairs.some(partner).over(pairs.some(partner + 1))
        for part, whole in zip(joined.parts, both.parts, strict=True):
            part[where] = whole
        pairs, count = joined, (count + 1) // 2
    return pairs


def with_channels(values: np.ndarray, channels: int, fill: float) -> np.ndarray:
    """Return values (…, own) with one for each channel, unless there is one for all of them."""
    own = values.shape[-1]
    if own == 1 or own == channels:
        return values
    more = np.full((*values.shape[:-1], channels - own), fill, values.dtype)
    return np.concatenate([values, more], axis=-1)
