"""Sizes of the cells of patches in a kernel, from a code that a patch's level has."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...backend import dr

_EXPONENT_BITS = 6


class PowersOfTwo:
    """Sizes that are powers of two, in finest units: their exponents are the code.

    Attributes
    ----------
    codes : array of uint32, shape (levels,)
    alike : bool
        Cells are as long as wide and high, in finest units.
    exact : bool
        Products with one over a size are not rounded.
    """

    exact = True

    def __init__(self, exponents: np.ndarray, extent: np.ndarray, backend: Any) -> None:
        self.backend = backend
        shifts = np.arange(3) * _EXPONENT_BITS
        self.codes = (exponents << shifts).sum(axis=1).astype(np.uint32)
        self.alike = bool((exponents == exponents[:, :1]).all())
        # Extents may take 53 bits in double precision.
        Whole: Any = backend.UInt if extent.max() < 1 << 31 else dr.uint64_array_t(backend.UInt)
        self.extent = [dr.opaque(Whole, int(n)) for n in extent]
        single = backend.precision == "single"
        self.Bits: Any = (
            dr.int32_array_t(backend.Float) if single else dr.int64_array_t(backend.Float)
        )
        self.bias, self.shift = (127, 23) if single else (1023, 52)

    def of(self, code: Any) -> tuple[list[Any], list[Any], list[Any]]:
        """Return sizes, one over them, and how many make the domain (modulo 2^32), per axis."""
        mask, UInt = (1 << _EXPONENT_BITS) - 1, self.backend.UInt
        if self.alike:
            exponents = [code & mask] * 3
        else:
            exponents = [(code >> (_EXPONENT_BITS * axis)) & mask for axis in range(3)]
        counts = [UInt(n >> type(n)(e)) for n, e in zip(self.extent, exponents, strict=True)]
        if self.alike:
            one = self.Bits(exponents[0])
            return [self._power(one)] * 3, [self._power(-one)] * 3, counts
        bits = [self.Bits(e) for e in exponents]
        return [self._power(b) for b in bits], [self._power(-b) for b in bits], counts

    def _power(self, exponent: Any) -> Any:
        return dr.reinterpret_array(self.backend.Float, (exponent + self.bias) << self.shift)


class AnySizes:
    """Sizes of any ratio, chosen by level, which is the code.

    There are few levels: choosing takes an operation for each, looking up a packet as long as ten.
    """

    exact = False

    def __init__(self, sizes: np.ndarray, extent: np.ndarray, backend: Any) -> None:
        self.codes = np.arange(len(sizes), dtype=np.uint32)
        self.alike = bool((sizes == sizes[:, :1]).all())
        self.per_axis = [
            [
                (
                    backend.opaque(float(s)),
                    backend.opaque(1.0 / s),
                    dr.opaque(backend.UInt, int(n) & 0xFFFFFFFF),
                )
                for s, n in zip(column, length // column, strict=True)
            ]
            for column, length in zip(sizes.T, extent, strict=True)
        ]

    def of(self, code: Any) -> tuple[list[Any], list[Any], list[Any]]:
        """Return sizes, one over them, and how many make the domain (modulo 2^32), per axis."""
        which = [code == level for level in range(len(self.codes) - 1)]
        found = [
            [_chosen(which, levels) for levels in zip(*axis, strict=True)] for axis in self.per_axis
        ]
        size, per_size, counts = (list(values) for values in zip(*found, strict=True))
        if self.alike:
            size, per_size = [size[0]] * 3, [per_size[0]] * 3
        return size, per_size, counts


def _chosen(which: list[Any], values: Any) -> Any:
    *others, found = values
    for mask, value in zip(which, others, strict=True):
        found = dr.select(mask, value, found)
    return found


def make_sizes(sizes: np.ndarray, extent: np.ndarray, backend: Any) -> PowersOfTwo | AnySizes:
    """Return the faster kind that the sizes (levels, 3) of cells allow."""
    mantissa, exponent = np.frexp(sizes.astype(float))
    if (mantissa == 0.5).all():
        return PowersOfTwo(exponent.astype(np.int64) - 1, extent, backend)
    return AnySizes(sizes, extent, backend)
