"""Where rays may take wider steps: a coarser interpolant of the fields is as good there.

Over a cube of 2, 4 or 8 dual cells the fields between its eight corners alone are compared with the
fields themselves, at every centre of a cell in it. Where no expression that the medium looks at is
off by more than a part of the width of its structures, the cube is one step of a ray. In the wings
of a shell, where little of it shows, more is allowed: up to its width. That divides the steps where
fields are smooth, and leaves them where they are not.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr, from_host
from ...expressions.interval import Interval
from ...grids.cartesian.coarse_walk import WIDEST
from ...grids.cartesian.leap import BITS
from ...media.profiles import Shaped
from ..coefficients.classify import Classifier, device_array
from .limits import Limit

# The corners of a cube.
_UP = tuple(itertools.product((0, 1), repeat=3))
# Optical depth of a step: a panel does not know which of several shells in it is in front.
_DEEPEST = 0.4
# The part of steps that must become wider for that to pay: the walk itself is slower.
_WORTHWHILE = 0.1


@dataclass
class Fields:
    """The fields that a medium needs, as they are, and what may be lost of its expressions.

    Attributes
    ----------
    data : dict of str to array
        Values at the centres of cells, flat.
    shape : tuple of int
        Cells along each axis.
    limits : tuple of Limit
        How far each expression may be off.
    """

    data: dict[str, Any]
    shape: tuple[int, ...]
    limits: tuple[Limit, ...]
    classifier: Classifier

    def at(self, node: list[Any]) -> dict[str, Any]:
        """Return all fields at a centre; number 0 is beyond the first, where it is the same."""
        Int, backend = self.classifier.backend.Int, self.classifier.backend
        flat = Int(0)
        for i, n in zip(node, self.shape, strict=True):
            flat = flat * dr.opaque(Int, n) + dr.clip(i - 1, 0, dr.opaque(Int, n - 1))
        return {
            name: backend.Wide(dr.gather(type(data), data, backend.UInt(flat)))
            for name, data in self.data.items()
        }


def wide_steps(
    classifier: Classifier,
    visible: np.ndarray,
    ranges: dict[str, Interval],
    limits: tuple[Limit, ...],
) -> np.ndarray | None:
    """Return log2 of how wide steps may be in each block, or None if few may be wide.

    Parameters
    ----------
    visible : bool array, shape (nx, ny, nz) in blocks
        Blocks that are not empty.
    ranges : dict of str to Interval
        The values of all fields in each block.
    limits : tuple of Limit
        How far expressions may be off.
    """
    backend, volume = classifier.backend, classifier.volume
    names = classifier.medium.names
    data = {n: device_array(volume.array(n).reshape(-1), backend) for n in names}
    fields = Fields(data, volume.grid.shape, limits, classifier)
    most = _widest(classifier, visible, ranges)
    steps = np.zeros(visible.shape, np.uint8)
    for step in range(WIDEST, 0, -1):
        left = visible & (steps == 0) & (most >= step)
        cubes = _resized(left, BITS - step, np.any)
        good = _resized(_good(fields, cubes, step), step - BITS, np.all)
        steps[left & good[tuple(slice(n) for n in left.shape)]] = step
    return steps if np.count_nonzero(steps) > _WORTHWHILE * np.count_nonzero(visible) else None


def _widest(classifier: Classifier, visible: np.ndarray, ranges: dict[str, Interval]) -> np.ndarray:
    """Return log2 of how wide steps may be in each block lest they are too deep.

    In front of a single shell, j and α of which are proportional, no depth is too much.
    """
    found = np.full(visible.shape, WIDEST, np.uint8)
    parts = classifier.medium.components()
    if len(parts) > 1 or not isinstance(parts[0], Shaped):
        own = {name: Interval(r.lo[visible], r.hi[visible]) for name, r in ranges.items()}
        dense = classifier.numbers.densest(classifier.most_in(own))
        found[visible] = np.sum(
            [dense * (1 << k) <= _DEEPEST for k in range(1, WIDEST + 1)], axis=0
        )
    return found


def _resized(cubes: np.ndarray, bits: int, all_or_any: Any) -> np.ndarray:
    """Return a mask of cubes 2^bits times smaller; or of larger ones, of all or any in them."""
    if bits >= 0:
        for axis in range(3):
            cubes = np.repeat(cubes, 1 << bits, axis=axis)
        return cubes
    side = 1 << -bits
    padded = np.pad(cubes, [(0, -n % side) for n in cubes.shape])
    nx, ny, nz = (n // side for n in padded.shape)
    found = all_or_any(padded.reshape(nx, side, ny, side, nz, side), axis=(1, 3, 5))
    return np.asarray(found)


def _good(fields: Fields, cubes: np.ndarray, step: int) -> np.ndarray:
    """Return which of some cubes of 2^step dual cells may be crossed in one step."""
    place = np.nonzero(cubes)
    found = np.zeros(cubes.shape, bool)
    if len(place[0]):
        Int = fields.classifier.backend.Int
        first = [from_host(Int, p << step) for p in place]
        found[place] = np.asarray(_Cubes(fields, first, 1 << step).smooth())
    return found


class _Cubes:
    """Cubes of dual cells, one per lane: the fields at their corners, and at all centres inside.

    Rays take expressions as linear between where they enter a cube and where they leave it, with
    fields that are trilinear between the corners: so both are compared with what is there.
    """

    def __init__(self, fields: Fields, first: list[Any], side: int) -> None:
        self.fields, self.first, self.side = fields, first, side
        self.backend = fields.classifier.backend
        self.context = fields.classifier.context(self.backend.Wide)
        self.corners = [
            fields.at([f + side * b for f, b in zip(first, up, strict=True)]) for up in _UP
        ]

    def smooth(self) -> Any:
        UInt, backend = self.backend.UInt, self.backend
        row = dr.opaque(UInt, self.side + 1)
        count = row * row * row
        exprs = {limit.expr.text: limit.expr for limit in self.fields.limits}
        planes = {text: (expr, self._affine(expr)) for text, expr in exprs.items()}

        def going_on(number: Any, good: Any) -> Any:
            return good & (number < count)

        def body(number: Any, good: Any) -> tuple[Any, Any]:
            plane = backend.quotient(number, row)
            layer = backend.quotient(plane, row)
            inner = [layer, plane - layer * row, number - plane * row]
            return number + 1, self._alike([backend.Int(i) for i in inner], planes)

        lanes = dr.width(self.first[0])
        state = (dr.zeros(UInt, lanes), dr.full(backend.Bool, True, lanes))
        _, good = dr.while_loop(state, going_on, body, label="coarse")
        return good

    def _affine(self, expr: Any) -> list[Any]:
        """Return the plane through an expression's values at the corners, by least squares.

        Its mean, and half its rise along each axis.
        """
        values = [self.context.evaluate(expr, corner) for corner in self.corners]
        means = [sum(values) * 0.125]
        for axis in range(3):
            means.append(
                sum(v if up[axis] else -v for v, up in zip(values, _UP, strict=True)) * 0.125
            )
        return means

    def _alike(self, inner: list[Any], planes: dict[str, tuple[Any, list[Any]]]) -> Any:
        exact = self.fields.at([f + i for f, i in zip(self.first, inner, strict=True)])
        fraction = [self.backend.Wide(i) * (1.0 / self.side) for i in inner]
        near = self._trilinear(fraction)
        values = {}
        for text, (expr, (mean, *rises)) in planes.items():
            flat = mean + sum(r * (2.0 * f - 1.0) for r, f in zip(rises, fraction, strict=True))
            taken = [self.context.evaluate(expr, near), flat]
            values[text] = self.context.evaluate(expr, exact), taken
        alike = dr.full(self.backend.Bool, True, 1)
        for limit in self.fields.limits:
            alike &= limit.kept(*values[limit.expr.text], self.context)
        return alike

    def _trilinear(self, fraction: list[Any]) -> dict[str, Any]:
        weights = []
        for up in _UP:
            parts = [f if b else 1.0 - f for f, b in zip(fraction, up, strict=True)]
            weights.append(parts[0] * parts[1] * parts[2])
        return {
            name: sum(w * c[name] for w, c in zip(weights, self.corners, strict=True))
            for name in self.fields.data
        }
