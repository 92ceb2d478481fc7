"""Lanes and pixels: the order in which rays are put into vectors."""

from __future__ import annotations

from typing import Any

from ..backend import dr

# Side of a block of pixels: within one, lanes follow the Morton curve, so that the lanes of a
# vector (16 of them) and the vectors after one another walk through the same cells.
BLOCK = 16
_BITS = 4


class PixelOrder:
    """The lanes of an image of (nx, ny) pixels."""

    def __init__(self, pixels: tuple[int, int]) -> None:
        self.nx, self.ny = pixels
        self.columns = -(-self.nx // BLOCK)
        self.rows = -(-self.ny // BLOCK)

    @property
    def lanes(self) -> int:
        """Number of lanes, those beyond the image's edges included."""
        return self.columns * self.rows * BLOCK * BLOCK

    def pixel(self, lane: Any, backend: Any) -> tuple[Any, Any, Any]:
        """Return pixel indices x and y of lanes, and which lanes are pixels (traced)."""
        within, block = lane & (BLOCK * BLOCK - 1), lane >> (2 * _BITS)
        UInt = backend.UInt
        columns = dr.opaque(UInt, self.columns)
        row = backend.quotient(block, columns)
        x = (block - row * columns) * BLOCK + _every_second_bit(within)
        y = row * BLOCK + _every_second_bit(within >> 1)
        return x, y, (x < dr.opaque(UInt, self.nx)) & (y < dr.opaque(UInt, self.ny))


def _every_second_bit(v: Any) -> Any:
    """Return bits 0, 2, 4 and 6 of a number, moved together."""
    v = v & 0x55
    v = (v | (v >> 1)) & 0x33
    return (v | (v >> 2)) & 0x0F


def subpixel_offsets(count: int) -> list[tuple[float, float]]:
    """Return the centres of count × count equal parts of a pixel, in pixels from its centre."""
    steps = [(k + 0.5) / count - 0.5 for k in range(count)]
    return [(a, b) for b in steps for a in steps]
