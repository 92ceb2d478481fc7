"""Where the leaves of an octree begin, in depth-first order.

Leaves fill the base cells one after the other, so the places where they begin are a running sum of
their sizes: a number with one digit per level, three bits each, which is kept in words of ten
digits so that trees may be thirty levels deep.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

# Levels that share a word of a place: three axes times ten bits, and room for sums over a part.
_LEVELS_PER_WORD = 10
_PART = 1 << 16


def _masks(n: int) -> list[int]:
    """Return masks of ten bits: groups of 1, 2, 4, 8 and 16 of them, which begin n·group apart."""
    return [
        sum(1 << (bit // group * group * n + bit % group) for bit in range(_LEVELS_PER_WORD))
        for group in (1, 2, 4, 8, 16)
    ]


_EVERY = {n: _masks(n) for n in (1, 2, 3)}


@dataclass(frozen=True)
class Places:
    """Where leaves begin, from their levels.

    Attributes
    ----------
    levels : array of uint8
        Levels of all leaves, in depth-first order.
    axes : tuple of int
        The axes that are halved, the one whose halves come first (x) first.
    """

    levels: np.ndarray
    axes: tuple[int, ...] = (0, 1, 2)

    @cached_property
    def deepest(self) -> int:
        """Highest level."""
        return int(self.levels.max(initial=0))

    @property
    def words(self) -> int:
        """Number of words of digits below the base cell's number."""
        return -(-self.deepest // _LEVELS_PER_WORD)

    @cached_property
    def _sizes(self) -> np.ndarray:
        """What a leaf of each level adds to the words of a place, the base number's first."""
        bits = len(self.axes)
        sizes = np.zeros((self.words + 1, self.deepest + 1), np.int64)
        for level in range(self.deepest + 1):
            word = -(-level // _LEVELS_PER_WORD)
            sizes[word, level] = 1 << bits * (word * _LEVELS_PER_WORD - level)
        return sizes

    @cached_property
    def _starts(self) -> np.ndarray:
        sums = [
            [self._sizes[:, self.levels[k : k + _PART]].sum(axis=1)]
            for k in range(0, len(self.levels), _PART)
        ]
        starts = np.concatenate([np.zeros((1, self.words + 1), np.int64), *sums])
        total = np.zeros(self.words + 1, np.int64)
        for row in starts:  # carried each time: sums over all parts do not fit
            total = _carried((total + row)[:, None], len(self.axes))[:, 0]
            row[:] = total
        return starts.T

    def total(self) -> tuple[int, bool]:
        """Return how many base cells the leaves fill, and whether the last one entirely."""
        end = self._starts[:, -1]
        return int(end[0]), not end[1:].any()

    def parts(self, first: int = 0, last: int | None = None) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield slices of leaves, and the words (words + 1, n) of the places where they begin."""
        last = len(self.levels) if last is None else last
        for k in range(first // _PART, -(-last // _PART)):
            begin, end = k * _PART, min((k + 1) * _PART, last)
            steps = self._sizes[:, self.levels[begin : end - 1]]
            words = np.empty((len(steps), end - begin), np.int64)
            words[:, :1] = self._starts[:, k : k + 1]
            np.cumsum(steps, axis=1, out=words[:, 1:])
            words[:, 1:] += words[:, :1]
            skip = max(first - begin, 0)
            yield slice(begin + skip, end), _carried(words, len(self.axes))[:, skip:]

    def aligned_levels(self) -> np.ndarray:
        """Return for each leaf the lowest level of a node that begins where the leaf does."""
        aligned = np.empty(len(self.levels), np.uint8)
        for part, words in self.parts():
            aligned[part] = self._aligned(words)
        return aligned

    def _aligned(self, words: np.ndarray) -> np.ndarray:
        bits, level = len(self.axes), np.zeros(words.shape[1], np.int64)
        for number, word in enumerate(words[1:], start=1):
            # The exponent of the lowest bit set tells the digit it is in.
            _, exponent = np.frexp((word & -word).astype(np.float64))
            own = number * _LEVELS_PER_WORD - (exponent - 1) // bits
            level = np.where(word > 0, own, level)
        return level

    def corners(self, first: int = 0, last: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return base numbers (n,), and lower corners (3, n) in units of the finest level there."""
        last = len(self.levels) if last is None else last
        base = np.empty(last - first, np.int64)
        corner = np.zeros((3, last - first), np.int64)
        for part, words in self.parts(first, last):
            here = slice(part.start - first, part.stop - first)
            base[here] = words[0]
            for k, axis in enumerate(self.axes):
                corner[axis, here] = self._gathered(words[1:], k)
        return base, corner

    def _gathered(self, words: np.ndarray, k: int) -> np.ndarray:
        """Return every bit of words that belongs to the k-th axis, moved together."""
        total = np.zeros(words.shape[1], np.int64)
        for word in words:
            total = (total << _LEVELS_PER_WORD) | _every_nth_bit(word >> k, len(self.axes))
        return total >> (self.words * _LEVELS_PER_WORD - self.deepest)


def _carried(words: np.ndarray, bits: int) -> np.ndarray:
    """Return words with all below the first reduced to their digits, the rest carried on."""
    full = bits * _LEVELS_PER_WORD
    for k in range(len(words) - 1, 0, -1):
        words[k - 1] += words[k] >> full
        words[k] &= (1 << full) - 1
    return words


def _every_nth_bit(v: np.ndarray, n: int) -> np.ndarray:
    """Return ten bits that lie n bits apart, moved together: by twos, fours, eights and all."""
    gathered = v & _EVERY[n][0]
    for together, mask in zip((1, 2, 4, 8), _EVERY[n][1:], strict=True):
        gathered |= gathered >> together * (n - 1)
        gathered &= mask
    return gathered


def spread_bits(v: np.ndarray, n: int) -> np.ndarray:
    """Return the ten bits of numbers moved n bits apart: the inverse of gathering every n-th."""
    spread = v & _EVERY[n][-1]
    for together, mask in zip((8, 4, 2, 1), _EVERY[n][-2::-1], strict=True):
        spread |= spread << together * (n - 1)
        spread &= mask
    return spread


def interleaved(corner: np.ndarray, deepest: int) -> np.ndarray:
    """Return the words of places below the base cell's number, from corners (3, n) in it.

    The inverse of `Places.corners`, for trees whose three axes are halved.
    """
    words = -(-deepest // _LEVELS_PER_WORD)
    corner = corner << (words * _LEVELS_PER_WORD - deepest)
    found = np.zeros((words, corner.shape[1]), np.int64)
    for number, word in enumerate(found):
        digits = corner >> ((words - 1 - number) * _LEVELS_PER_WORD)
        for axis in range(3):
            word |= spread_bits(digits[axis] & 0x3FF, 3) << axis
    return found
