"""What part of a particle's kernel lies in a node, in kernels.

The kernel is summed over midpoints of the box that the node and the cube around the particle's
support have in common: in small nodes few, in large ones as many as the kernel needs.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..backend import dr, from_host
from .kernels import Kernel
from .overlaps import Overlaps, Pairs

# Midpoints are at most this part of the support's radius apart.
_STEP = 0.25
# Where a kernel is fainter than this part of its centre it is left out, at the rim: densities fall
# by twelve decades there, which is no property of the data, and pictures in log10 show it.
_FAINT = 1e-3


class KernelWeights:
    """Parts of kernels in nodes.

    Parameters
    ----------
    overlaps : Overlaps
    kernel : Kernel
    """

    def __init__(self, overlaps: Overlaps, kernel: Kernel) -> None:
        self.overlaps, self.kernel = overlaps, kernel
        self.backend = overlaps.backend
        # Lengths are in radii of the support here: single precision is enough.
        self.single = self.backend.with_precision("single")

    def of(self, pairs: Pairs) -> np.ndarray:
        """Return the weights of pairs, float32: they add up to about one for each particle."""
        UInt, over = self.backend.UInt, self.overlaps
        packet = self.backend.packet(4)
        box = dr.gather(packet, over.boxes, from_host(UInt, pairs.node))
        sphere = dr.gather(packet, over.spheres, from_host(UInt, pairs.particle))
        low, size = [], []
        for axis, width in enumerate(over.width):
            a, b = self._common(box[axis] - sphere[axis], box[3] * width, sphere[3])
            low.append(a)
            size.append(b - a)
        return np.array(self._integral(low, size))

    def _common(self, low: Any, width: Any, radius: Any) -> tuple[Any, Any]:
        """Return where the common box begins and ends along an axis, in radii from the centre."""
        a, b = (self.single.Float(v / radius) for v in (low, low + width))
        return dr.select(a > -1.0, a, -1.0), dr.select(b < 1.0, b, 1.0)

    def _integral(self, low: list[Any], size: list[Any]) -> Any:
        UInt, Float = self.single.UInt, self.single.Float
        counts = [UInt(dr.ceil(s * (1.0 / _STEP))) for s in size]
        counts = [dr.select(n > 0, n, 1) for n in counts]
        steps = [s / Float(n) for s, n in zip(size, counts, strict=True)]
        number = counts[0] * counts[1] * counts[2]

        def more(k: Any, index: list[Any], total: Any) -> Any:
            return k < number

        def add(k: Any, index: list[Any], total: Any) -> tuple[Any, list[Any], Any]:
            parts = zip(low, steps, index, strict=True)
            x, y, z = (dr.fma(Float(i) + 0.5, step, start) for start, step, i in parts)
            u = dr.sqrt(x * x + y * y + z * z)
            return k + 1, _next(index, counts), total + self.kernel.shape(u, _positive)

        nothing = dr.zeros(Float, dr.width(number))
        state = (UInt(nothing), [UInt(nothing) for _ in counts], nothing)
        total = dr.while_loop(state, more, add, label="kernel")[2]
        least = dr.opaque(Float, _FAINT * self.kernel.peak)
        total = dr.select(total < least * Float(number), 0.0, total)
        return total * (steps[0] * steps[1] * steps[2]) * self.kernel.norm


def _next(index: list[Any], counts: list[Any]) -> list[Any]:
    """Return the next place of an array of some shape, the first axis fastest."""
    i, j, k = index
    row = i + 1 == counts[0]
    layer = row & (j + 1 == counts[1])
    j = dr.select(row, j + 1, j)
    return [dr.select(row, 0, i + 1), dr.select(layer, 0, j), dr.select(layer, k + 1, k)]


def _positive(x: Any) -> Any:
    return dr.select(x > 0.0, x, 0.0)
