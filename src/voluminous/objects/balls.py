"""How much of a pixel an ellipse covers, exactly: the area of a circle within a parallelogram.

Points of the picture are complex numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..backend import dr, from_host
from .contract import View, window_pixels

_CORNERS = np.array([-0.5 - 0.5j, 0.5 - 0.5j, 0.5 + 0.5j, -0.5 + 0.5j])
# Less of a pixel, or of the ellipse, is nothing.
_LEAST = 1e-9
# Pixels looked at together: what is made on the way fits into the processor's cache.
_TOGETHER = 4096
# How far the image of a ball may be off an ellipse, as a fraction of its size.
_ROUND = 0.02
# Where in a pixel rays tell how much of it is covered.
_PARTS = (-0.375, -0.125, 0.125, 0.375)
# Images of fewer pixels are too small for a ray to tell where on the ball it is.
_FEW = 12.0
# The mean of the cosine between rays and normals over the image of a ball.
_MEAN_COSINE = 2.0 / 3.0
# Side of tiles in pixels.
_TILE = 64.0

# Which ball, x, y and the covered part of pixels.
Covered = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass
class Ellipses:
    """Ellipses ``center + a cos φ + b sin φ``, in pixels; complex arrays of shape (n,)."""

    center: np.ndarray
    a: np.ndarray
    b: np.ndarray

    @classmethod
    def through(
        cls, right: np.ndarray, left: np.ndarray, up: np.ndarray, down: np.ndarray
    ) -> Ellipses:
        """Return the ellipses with one axis from `left` to `right`, through `up` and `down`."""
        center, a = 0.5 * (right + left), 0.5 * (right - left)
        b, off = 0.5 * (up - down), 0.5 * (up + down) - center
        with np.errstate(invalid="ignore", divide="ignore"):
            part = (off * a.conj()).real / np.abs(a) ** 2
            return cls(center, a, b / np.sqrt(np.maximum(1.0 - part**2, 1e-12)))

    def coverage(self, pixels: tuple[int, int]) -> Covered:
        """Return which ellipse, x, y and the covered part of all pixels that are touched.

        Where the centre is NaN there is none.
        """
        cx, cy = self.center.real.copy(), self.center.imag.copy()
        width, height = (np.hypot(part(self.a), part(self.b)) for part in (np.real, np.imag))
        owner, x, y = window_pixels(
            np.stack([cx - width, cx + width]), np.stack([cy - height, cy + height]), pixels
        )
        # Pixels as they are where ellipses are unit circles.
        right, up = self._turned(np.array([1.0, 1.0j])[:, None])
        corners = self._turned(_CORNERS[:, None])
        reach, size = np.max(np.abs(corners[:2]), axis=0), cross(self.a, self.b)
        covered = np.empty(len(owner))
        for first in range(0, len(owner), _TOGETHER):
            part = slice(first, first + _TOGETHER)
            one = owner[part]
            place = (x[part] - cx.take(one)) * right.take(one)
            place += (y[part] - cy.take(one)) * up.take(one)
            distance, far = np.abs(place), reach.take(one)
            inside = np.where(distance + far <= 1.0, 1.0, 0.0)
            edge = np.flatnonzero((distance + far > 1.0) & (distance - far < 1.0))
            one = one.take(edge)
            area = disc_in_polygon(place.take(edge) + corners.take(one, axis=1))
            # Corners run clockwise where b is to the right of a: both signs turn.
            inside[edge] = np.clip(area * size.take(one), 0.0, 1.0)
            covered[part] = inside
        some = np.flatnonzero(covered > (_LEAST * np.minimum(np.abs(size), 1.0)).take(owner))
        return owner.take(some), x.take(some), y.take(some), covered.take(some)

    def _turned(self, direction: np.ndarray) -> np.ndarray:
        a, b = self.a, self.b
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray((cross(direction, b) + 1j * cross(a, direction)) / cross(a, b))

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return how far points are from the centres: 1 on the ellipse; NaN for none."""
        return np.asarray(np.abs(self._turned(points - self.center)))


def disc_in_polygon(corners: np.ndarray) -> np.ndarray:
    """Return the area of the unit disc within polygons, positive if corners run anticlockwise.

    The corners (k, n) of a polygon are in a column. Each side makes a triangle with the centre; the
    disc is a triangle between two sectors of it. Places on a side count from the foot of the
    perpendicular from the centre.
    """
    side = np.roll(corners, -1, axis=0) - corners
    length = np.abs(side)
    distance = cross(corners, side) / length
    begin = (corners.real * side.real + corners.imag * side.imag) / length
    end = begin + length
    reach = np.sqrt(np.maximum(1.0 - distance**2, 0.0))
    # Nothing is between them where the side misses the disc.
    first, last = np.clip(-reach, begin, end), np.clip(reach, begin, end)
    square, inner = distance**2, distance * (last - first)
    sectors = np.arctan2(distance * length, square + begin * end)
    sectors -= np.arctan2(inner, square + first * last)
    return np.asarray(0.5 * np.sum(inner + sectors, axis=0))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the signed area between two vectors."""
    return np.asarray(a.real * b.imag - a.imag * b.real)


@dataclass
class Balls:
    """Centres (n, 3) and radii (n,), as plain numbers, and how they are looked at."""

    center: np.ndarray
    radius: np.ndarray
    view: View

    def __post_init__(self) -> None:
        # The sines of the angles between the centres of balls and their edges.
        self.sine = np.zeros(len(self.radius))
        if self.view.observer is not None:
            distance = np.linalg.norm(self.center - self.view.observer, axis=1)
            self.sine = self.radius / np.maximum(distance, self.radius)

    def covered(self) -> Covered:
        """Return which ball, x, y and the covered part of all pixels where there is one.

        The diameter of the circle in which rays touch a ball towards the picture's middle is seen
        as one axis of an ellipse, in parallel and in flat projection. The other axis follows from
        any third point of the circle. Rays tell what is covered by images that are no ellipses.
        """
        sine, view = self.sine, self.view
        direction = view.directions(self.center)
        middle = self.center - (self.radius * sine)[:, None] * direction
        half = (self.radius * np.sqrt(1.0 - sine**2))[:, None]
        e, f = (half * side for side in view.across(direction))
        more = np.sqrt(0.5) * (e + f), np.sqrt(0.5) * (e - f), -np.sqrt(0.5) * (e + f)
        ends = [self._image(middle + offset) for offset in (e, -e, f, -f, *more)]
        outline = Ellipses.through(*ends[:4])
        off = np.max([np.abs(outline.distance(end) - 1.0) for end in ends[4:]], axis=0)
        # Of one that reaches behind a dome's observer, the outline is around everything else.
        around = outline.distance(self._image(self.center)) < 1.0
        odd = ~(off < _ROUND) | ~around | (sine >= 1.0)
        unseen = np.all(np.isnan(ends[:4]), axis=0) & (sine < 1.0)
        outline.center[odd] = np.nan
        parts = [outline.coverage(view.frame.pixels)]
        parts += [self._by_rays(int(ball)) for ball in np.flatnonzero(odd & ~unseen)]
        owner, x, y, covered = (np.concatenate(rows) for rows in zip(*parts, strict=True))
        return owner, x, y, covered

    def _image(self, points: np.ndarray) -> np.ndarray:
        x, y, _ = self.view.place(points)
        return np.asarray(x + 1j * y)

    def _by_rays(self, ball: int) -> Covered:
        y, x = (a.ravel().astype(float) for a in np.indices(self.view.frame.pixels[::-1]))
        owner, radius = np.full(len(x), ball), self.radius[ball]
        distance, miss, _ = self._nearest(owner, x, y)
        if self.sine[ball] >= 1.0:
            covered = np.ones(len(x))
        else:
            covered = np.where((miss < radius) & (distance > 0.0), 1.0, 0.0)
            footprint = np.abs(distance) * max(self.view.frame.pixel)
            edge = np.flatnonzero(np.abs(radius - miss) < footprint)
            du, dv = (d.reshape(-1, 1) for d in np.meshgrid(_PARTS, _PARTS))
            inner = x[edge] + du, y[edge] + dv
            distance, miss, _ = self._nearest(np.full(inner[0].size, ball), *map(np.ravel, inner))
            met = ((miss < radius) & (distance > 0.0)).reshape(du.size, -1)
            covered[edge] = met.mean(axis=0)
        some = np.flatnonzero(covered)
        return owner[some], x[some].astype(np.int64), y[some].astype(np.int64), covered[some]

    def _nearest(
        self, owner: np.ndarray, x: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if not len(x):
            return np.empty(0), np.empty(0), np.empty(0)
        Wide, UInt = self.view.backend.Wide, self.view.backend.UInt
        ray, ball = self.view.traced_rays(x, y), from_host(UInt, owner)
        radius, *center = (
            dr.gather(Wide, from_host(Wide, values), ball)
            for values in (self.radius, *self.center.T)
        )
        away = [c - o for c, o in zip(center, ray.origin, strict=True)]
        distance = sum(a * d for a, d in zip(away, ray.direction, strict=True))
        off = [a - distance * d for a, d in zip(away, ray.direction, strict=True)]
        miss = dr.sqrt(sum(a * a for a in off))
        half = (radius - miss) * (radius + miss)
        half = dr.sqrt(dr.select(half > 0.0, half, 0.0))
        dr.eval(distance, miss, half)
        return np.asarray(distance), np.asarray(miss), np.asarray(half)

    def meet(self, pixels: Covered) -> tuple[np.ndarray, np.ndarray]:
        """Return the depths at which the rays of pixels meet balls, and cosines to the normal.

        From inside it is where they leave.
        """
        owner, x, y, covered = pixels
        distance, _, half = self._nearest(owner, x.astype(float), y.astype(float))
        near, far = distance - half, distance + half
        if self.view.observer is not None:
            near = np.where(near > 0.0, near, np.where(far > 0.0, far, np.nan))
        few = np.bincount(owner, covered, len(self.radius))[owner] < _FEW
        return near, np.where(few, _MEAN_COSINE, half / self.radius[owner])


def nearby(x: np.ndarray, y: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return the order of things at x, y in pixels: tile by tile, in each by depth.

    Rays of one vector are followed together until the last one of them arrives. What is not in the
    picture (NaN) comes last.
    """
    column, row = (np.floor(w / _TILE) for w in (x, y))
    return np.lexsort((depth, column, row))
