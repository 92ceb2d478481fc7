"""The shadow of a box on square pixels, in closed form.

The column of an even box, seen along any direction, is the convolution of three segments: its
projected edges. Its mean over a pixel is that convolved with two more, the pixel's edges: a
bivariate box spline of five directions (de Boor, Höllig & Riemenschneider 1993, *Box Splines*). It
is summed up here over all pixels to the left and below, and given by differences of truncated
powers,

    F(x) = Σ_k (-1)^|k| T(x - Σ k_i e_i),        k_i = 0, 1,  e_i the box's edges,

where T, the truncated power of the five directions ξ = (ℓ, τ ℓ), is a univariate B-spline N of
their slopes τ (Curry & Schoenberg 1966): T(s, m) = s³ N(m/s | τ) / (3! Π ℓ (τ_5 - τ_1)). The
recursion of de Boor and Cox evaluates it without any loss of digits, also where directions
coincide; multiplied out with s it has no quotient.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from ..backend import dr

# An edge shorter than this, of the longest, is seen along its length: leaving it out changes the
# mean by the square of that, and its inverse would cost as many digits.
_SHORT = 3e-5
# Slopes closer than this are one.
_SAME = 1e-9


class BoxSpline:
    """The shadows of boxes with edges in three given directions.

    Parameters
    ----------
    directions : array, shape (3, 2)
        Where edges of unit length end, in pixels.

    Attributes
    ----------
    kept : list of int
        The edges that are seen at all.
    """

    def __init__(self, directions: np.ndarray) -> None:
        lengths = np.hypot(*directions.T)
        self.kept = [k for k in range(3) if lengths[k] > _SHORT * lengths.max()]
        along = _along(directions[self.kept])
        self.axes = np.array([along, [-along[1], along[0]]])
        edges = directions[self.kept]
        # A box is the same when its edges are counted the other way.
        self.edges = edges * np.where(edges @ along < 0, -1.0, 1.0)[:, None]
        own = np.concatenate([self.edges, np.eye(2)]) @ self.axes.T
        self.slopes = _merged(np.sort(own[:, 1] / own[:, 0]))
        self.lead = 1.0 / (
            math.factorial(len(own) - 2) * np.prod(own[:, 0]) * (self.slopes[-1] - self.slopes[0])
        )

    def traced(self, backend: Any) -> TracedBoxSpline:
        """Return it as run-time data of a kernel."""
        return TracedBoxSpline(self, backend)


def _along(edges: np.ndarray) -> np.ndarray:
    """Return a direction in the first quadrant that is farthest from the normals of all edges."""
    normals = (np.arctan2(edges[:, 1], edges[:, 0]) + 0.5 * np.pi) % np.pi
    angles = np.sort([0.0, 0.5 * np.pi, *normals[normals < 0.5 * np.pi]])
    widest = int(np.argmax(np.diff(angles)))
    angle = 0.5 * (angles[widest] + angles[widest + 1])
    return np.array([np.cos(angle), np.sin(angle)])


def _merged(slopes: np.ndarray) -> np.ndarray:
    for k in range(1, len(slopes)):
        if slopes[k] - slopes[k - 1] < _SAME:
            slopes[k] = slopes[k - 1]
    return slopes


class TracedBoxSpline:
    """A `BoxSpline` in a kernel."""

    def __init__(self, spline: BoxSpline, backend: Any) -> None:
        o = backend.opaque
        self.real = backend.Float
        self.along, self.across = [[o(float(c)) for c in axis] for axis in spline.axes]
        self.edges = [[o(float(c)) for c in edge] for edge in spline.edges]
        self.slopes = [o(float(t)) for t in spline.slopes]
        self.lead = o(float(spline.lead))
        self.inverse = [
            [o(_inverse(b - a)) for a, b in zip(spline.slopes, spline.slopes[k:], strict=False)]
            for k in range(1, len(spline.slopes) - 1)
        ]

    def box(self, lengths: list[Any]) -> Box:
        """Return boxes with edges of given lengths (arrays)."""
        return Box(self, lengths)

    def turned(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return a vector's components along and across."""
        (a, b), (c, d) = self.along, self.across
        return dr.fma(a, x, b * y), dr.fma(c, x, d * y)

    def power(self, s: Any, m: Any) -> Any:
        """Return T without its leading factor: s³ N(m/s), by de Boor's recursion."""
        d = [dr.fma(-slope, s, m) for slope in self.slopes]
        above = [value >= 0.0 for value in d]
        zero = self.real(0)
        # The first two steps at once: one of the intervals between slopes holds m/s.
        part = [dr.select(above[j] & ~above[j + 1], self.real(1), zero) for j in range(len(d) - 1)]
        for k, inverse in enumerate(self.inverse, 1):
            part = [
                dr.fma(d[j] * inverse[j], part[j], -(d[j + k + 1] * inverse[j + 1]) * part[j + 1])
                for j in range(len(part) - 1)
            ]
        return dr.select(s > 0.0, part[0], zero)


class Box:
    """Boxes of one kind: what is the same wherever their shadows are looked at."""

    def __init__(self, spline: TracedBoxSpline, lengths: list[Any]) -> None:
        self.spline, real = spline, spline.real
        edges = [[h * c for c in edge] for h, edge in zip(lengths, spline.edges, strict=True)]
        self.lead = spline.lead
        for h in lengths:
            self.lead = self.lead / h
        self.origin = [-0.5 * sum(edge[a] for edge in edges) for a in range(2)]
        turned = [spline.turned(*edge) for edge in edges]
        self.corners = []
        for subset in itertools.product((0, 1), repeat=len(edges)):
            there = [t for t, k in zip(turned, subset, strict=True) if k]
            s, m = (sum((t[a] for t in there), real(0)) for a in range(2))
            self.corners.append((-1.0 if sum(subset) % 2 else 1.0, s, m))

    def covered(self, x: Any, y: Any) -> Any:
        """Return the part of a box, centred at 0, whose shadow is to the left of x and below y."""
        s, m = self.spline.turned(x - self.origin[0], y - self.origin[1])
        total = self.spline.real(0)
        for sign, ds, dm in self.corners:
            total = dr.fma(sign, self.spline.power(s - ds, m - dm), total)
        return total * self.lead


def _inverse(width: float) -> float:
    return 1.0 / width if width > 0.0 else 0.0
