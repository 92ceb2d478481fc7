"""Decimal numbers in a text, all at once: where they are, what their digits make, which double.

One number costs about 100 ns in NumPy calls that release the interpreter's lock; Python's own
`float` takes three times that and keeps the lock (measured with 16 digits). What is not written
as numbers usually are is left to `text.number`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .powers import LEAST, MOST, scaled

# Spaces that a text needs behind it: words of eight characters are looked at.
PADDING = 32
_SPACE, _PLUS, _MINUS, _POINT, _LETTER = 32, 43, 45, 46, 100
# No 64-bit number overflows with so many digits; so many are looked at together.
_DIGITS, _WORD = 19, 8
_TENS = 10 ** np.arange(_DIGITS + 1, dtype=np.uint64)
_U = np.uint64
Places = NDArray[np.intp]


def decimals(
    text: NDArray[np.uint8],
) -> tuple[NDArray[np.float64], NDArray[np.bool_], Places, Places]:
    """Return the numbers in a text.

    Parameters
    ----------
    text : array of uint8
        ASCII, numbers between white space; a space in front, and `PADDING` of them behind.

    Returns
    -------
    values : array of float64
        The nearest doubles.
    unsure : array of bool
        True for values that have to be read in another way, among them all that are no numbers.
    starts, ends : array of int
        Where numbers begin, and the character after their last one.
    """
    blank = text <= _SPACE
    turns = np.flatnonzero(blank[1:] != blank[:-1]) + 1
    starts, ends = turns[0::2].copy(), turns[1::2].copy()
    # Words begin at every character; the first character is the lowest byte on all machines.
    words: NDArray[np.uint64] = np.ndarray(len(text) - _WORD + 1, "<u8", text, 0, (1,))
    negative, first = _signed(text, starts)
    letter = _letters(text, starts, ends)
    point = _points(text, first, letter, ends)
    unsure = np.zeros(len(starts), bool)
    whole, places = _digits(words, first, point, letter, unsure)
    exponent = _exponents(text, words, letter, ends, unsure) - places
    unsure |= (exponent < LEAST) | (exponent > MOST)
    values = scaled(whole, exponent, unsure)
    np.negative(values, where=negative, out=values)
    return values, unsure, starts, ends


def _signed(text: NDArray[np.uint8], at: Places) -> tuple[NDArray[np.bool_], Places]:
    sign = text.take(at)
    negative = sign == _MINUS
    return negative, at + (negative | (sign == _PLUS))


def _letters(text: NDArray[np.uint8], starts: Places, ends: Places) -> Places:
    """Return the places of the letters (E, e, D, d) before exponents; the end where none is."""
    # Exponents mostly have a sign and two digits, or three: looking there is faster than searching.
    letter = ends - 4
    letter -= ~_is_letter(text.take(letter))
    if _is_letter(text.take(letter, mode="clip")).all() and (letter > starts).all():
        return letter
    found = np.flatnonzero(_is_letter(text))
    letter = ends.copy()
    letter[np.searchsorted(ends, found, "right")] = found
    return letter


def _is_letter(characters: NDArray[np.uint8]) -> NDArray[np.bool_]:
    # D and E differ in the lowest bit, capitals in one more.
    is_letter: NDArray[np.bool_] = ((characters | 32) & 0xFE) == _LETTER
    return is_letter


def _points(text: NDArray[np.uint8], first: Places, letter: Places, ends: Places) -> Places:
    point = first + 1
    if (text.take(point) == _POINT).all() and (point < letter).all():
        return point
    found = np.flatnonzero(text == _POINT)
    point = letter.copy()
    point[np.searchsorted(ends, found, "right")] = found
    return point


def _digits(
    words: NDArray[np.uint64],
    first: Places,
    point: Places,
    letter: Places,
    unsure: NDArray[np.bool_],
) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Return all digits as whole numbers, and how many of them are after the point."""
    before, after = point - first, np.maximum(letter - point - 1, 0)
    unsure |= (before < 0) | (before + after > _DIGITS) | (before + after < 1)
    whole = _run(words, first, before, unsure)
    whole *= _TENS.take(after, mode="clip")
    whole += _run(words, point + 1, after, unsure)
    return whole, after


def _run(
    words: NDArray[np.uint64], first: Places, count: Places, unsure: NDArray[np.bool_]
) -> NDArray[np.uint64]:
    found = _up_to_eight(words, first, count, unsure)
    for read in range(_WORD, min(int(count.max(initial=0)), _DIGITS), _WORD):
        left = np.clip(count - read, 0, _WORD)
        found *= _TENS.take(left)
        found += _up_to_eight(words, first + read, left, unsure)
    return found


def _exponents(
    text: NDArray[np.uint8],
    words: NDArray[np.uint64],
    letter: Places,
    ends: Places,
    unsure: NDArray[np.bool_],
) -> NDArray[np.int64]:
    negative, first = _signed(text, letter + 1)
    count = ends - first
    unsure |= (count > 4) | ((count < 1) & (letter < ends))
    exponent = _up_to_eight(words, first, np.clip(count, 0, 4), unsure).view(np.int64)
    np.negative(exponent, where=negative, out=exponent)
    return exponent


def _up_to_eight(
    words: NDArray[np.uint64], at: Places, count: Places, unsure: NDArray[np.bool_]
) -> NDArray[np.uint64]:
    """Return the numbers that the first `count` (8 at most) characters of words make.

    All eight are handled as one number. The first character is the lowest byte: moved up, so that
    those which do not count fall out at the top, zeros come in front.
    """
    x = words[np.minimum(at, len(words) - 1)] ^ _U(0x3030303030303030)
    x <<= _U(64) - (np.minimum(np.maximum(count, 0), _WORD).astype(_U) << _U(3))
    unsure |= ((x + _U(0x0606060606060606)) | x) & _U(0xF0F0F0F0F0F0F0F0) != 0  # no digit
    x = (x * _U(10) + (x >> _U(8))) & _U(0x00FF00FF00FF00FF)
    x = (x * _U(100) + (x >> _U(16))) & _U(0x0000FFFF0000FFFF)
    return (x * _U(10000) + (x >> _U(32))) & _U(0xFFFFFFFF)
