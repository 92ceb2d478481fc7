"""Fields interpolated between cell centres, classified on the ray: composite quadrature.

Nothing here is a closed form of the transfer equation: rays are cut where any coordinate passes a
centre, cut again where a scalar turns round or passes values that a medium names, and what lies
between is halved until two rules of Gauss and Legendre agree.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

NODES = 12
# Where the mass of a Gaussian is, in sigma: panels between these are smooth on their own scale.
GRADES = (0.0, 0.7, 1.5, 2.5, 3.5, 4.5, 6.0, 8.0)
# Places at which turning points of a scalar are looked for in a segment.
_LOOKS = 49
_BISECTIONS = 60
# Local errors relative to the largest value in the bundle: hundreds of panels stay below 1e-11.
_ACCURACY = 1e-13
_ROUNDS = 60
# Deeper panels are cut where they can be seen: both rules may miss what shines at the near end.
_DEEPEST = 2.0
_UNSEEN = 1e-18
# What rounding a scalar near a shell's centre does to the shape, in units of centre over width.
_NOISE = 4e-15
_STEP = 1e-30  # of derivatives by complex numbers: exact, nothing is subtracted

Scalar = Callable[[dict[str, np.ndarray]], np.ndarray]


@dataclass
class Shell:
    """Gaussian or rectangle of a scalar: `color` and `opacity` per unit length at its peak."""

    scalar: Scalar
    center: float
    width: float
    color: Sequence[float]
    opacity: Sequence[float]
    kind: str = "gaussian"

    @property
    def steepness(self) -> float:
        """How much the shape magnifies rounding of the scalar."""
        return abs(self.center) / self.width

    @property
    def values(self) -> list[float]:
        """Values of the scalar at which rays are cut."""
        grades = GRADES if self.kind == "gaussian" else (1.0,)
        return [self.center + sign * g * self.width for g in grades for sign in (-1, 1)]

    def __call__(self, along: Along, t: np.ndarray) -> np.ndarray:
        """Return j and α, shape (2, channel, …)."""
        z = (self.scalar(along.fields(t)) - self.center) / self.width
        shape = np.exp(-0.5 * z * z) if self.kind == "gaussian" else (np.abs(z) <= 1) * 1.0
        return np.multiply.outer(np.array(np.broadcast_arrays(self.color, self.opacity)), shape)


@dataclass
class Surface:
    """Surfaces where a scalar has a value; of no thickness, or `width` of the scalar thick."""

    scalar: Scalar
    level: float
    color: Sequence[float]
    opacity: Sequence[float]
    width: float = 0.0

    @property
    def values(self) -> list[float]:
        """Values of the scalar at which rays are cut."""
        return [self.level - 0.5 * self.width, self.level + 0.5 * self.width]

    def __call__(self, along: Along, t: np.ndarray) -> np.ndarray:
        """Return j and α, in proportion to how fast the scalar varies along the ray."""
        depth = -np.log1p(-np.asarray(self.opacity))
        x = self.scalar(along.fields(t))
        slope = np.abs(self.scalar(along.fields(t + 1j * _STEP)).imag) / _STEP
        density = slope * (np.abs(x - self.level) <= 0.5 * self.width) / max(self.width, 1e-300)
        rows = np.broadcast_arrays(self.color * depth, depth)
        return np.multiply.outer(np.array(rows), density)


@dataclass
class Smooth:
    """Any smooth emissivity and extinction: `function(fields)` returns two lists."""

    function: Callable[[dict[str, np.ndarray]], tuple[list[Any], list[Any]]]
    scalar: Scalar | None = None
    values: Sequence[float] = ()

    def __call__(self, along: Along, t: np.ndarray) -> np.ndarray:
        """Return j and α."""
        j, alpha = self.function(along.fields(t))
        alpha = alpha * len(j) if len(alpha) == 1 else alpha
        return np.array([[np.zeros(t.shape) + v for v in row] for row in (j, alpha)])


@dataclass
class Along:
    """Pieces of rays, each within eight centres: where fields are evaluated.

    Attributes
    ----------
    lower, upper, pitch : arrays, shape (3, N)
        Indices of the centres around a piece, and one over their distance; zero where a field is
        constant along the axis.
    corner, origin, direction : arrays, shape (3, N)
        Coordinates of the lower centres, and the ray.
    """

    arrays: dict[str, np.ndarray]
    lower: np.ndarray
    upper: np.ndarray
    pitch: np.ndarray
    corner: np.ndarray
    origin: np.ndarray
    direction: np.ndarray

    def fields(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """Return all fields and coordinates at distances t, shape (N, …)."""
        place = [
            _column(o, t) + t * _column(d, t)
            for o, d in zip(self.origin, self.direction, strict=True)
        ]
        f = [
            (p - _column(c, t)) * _column(w, t)
            for p, c, w in zip(place, self.corner, self.pitch, strict=True)
        ]
        found = {name: self._trilinear(a, f) for name, a in self.arrays.items()}
        return {**found, **dict(zip("xyz", place, strict=True))}

    def _trilinear(self, array: np.ndarray, f: list[np.ndarray]) -> np.ndarray:
        total: Any = 0.0
        ends = (self.lower, self.upper)
        for i, j, k in np.ndindex(2, 2, 2):
            corner = array[ends[i][0], ends[j][1], ends[k][2]]
            weight = 1.0
            for side, g in zip((i, j, k), f, strict=True):
                weight = weight * (g if side else 1.0 - g)
            total = total + _column(corner, f[0]) * weight
        return total

    def take(self, index: np.ndarray) -> Along:
        """Return some of the pieces, or some of them repeated."""
        rest = (self.lower, self.upper, self.pitch, self.corner, self.origin, self.direction)
        return Along(self.arrays, *(a[:, index] for a in rest))


def _column(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    return values.reshape(values.shape + (1,) * (like.ndim - 1))


@dataclass
class Panels:
    """Pieces of rays sorted by ray and distance; `event` is a part crossed at a point, or -1."""

    ray: np.ndarray
    piece: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    event: np.ndarray

    def take(self, index: np.ndarray) -> Panels:
        """Return some of them."""
        return Panels(*(a[index] for a in vars(self).values()))

    def joined(self, other: Panels) -> Panels:
        """Return all of both, sorted."""
        both = [
            np.concatenate(pair)
            for pair in zip(vars(self).values(), vars(other).values(), strict=True)
        ]
        whole = Panels(*both)
        return whole.take(np.lexsort((whole.end, whole.begin, whole.ray)))


def bundle(
    edges: Sequence[np.ndarray],
    fields: dict[str, np.ndarray],
    parts: Sequence[Any],
    origins: np.ndarray,
    directions: np.ndarray,
    *,
    start: bool = False,
    background: float = 0.0,
) -> dict[str, np.ndarray]:
    """Solve the transfer equation along rays.

    Parameters
    ----------
    edges : sequence of 3 arrays
        Cell walls along x, y, z.
    fields : dict of arrays (nx, ny, nz)
        Values at the cells' centres.
    parts : sequence of Shell, Surface or Smooth
        Media that are added.
    origins, directions : arrays, shape (R, 3)
        Rays from the observer; directions of length one.
    start : bool
        True if rays begin at their origins, False if they are whole lines.

    Returns
    -------
    dict
        ``intensity``, ``transparency`` and ``optical_depth``, shape (R, channel).
    """
    fields = {name: np.asarray(a, float) for name, a in fields.items()}
    ray, along, begin, end = _pieces(edges, fields, origins, directions, start)
    panels = _cut(parts, ray, along, begin, end)
    return _fold(parts, _refined(parts, panels, along), along, len(origins), background)


def _pieces(edges, fields, origins, directions, start):
    """Cut rays where a coordinate passes a centre or a face of the domain."""
    planes = [np.concatenate([e[:1], 0.5 * (e[1:] + e[:-1]), e[-1:]]) for e in edges]
    first, last = _between_faces(edges, origins, directions)
    first = np.maximum(first, 0.0) if start else first
    first, last = np.where(last > first, first, 0.0), np.where(last > first, last, 0.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        t = np.concatenate(
            [(p - origins[:, [a]]) / directions[:, [a]] for a, p in enumerate(planes)], axis=1
        )
    t = np.clip(np.where(np.isfinite(t), t, -np.inf), first[:, None], last[:, None])
    t = np.sort(np.concatenate([first[:, None], t, last[:, None]], axis=1), axis=1)
    ray, column = np.nonzero(t[:, 1:] > t[:, :-1])
    begin, end = t[ray, column], t[ray, column + 1]
    middle = origins[ray] + 0.5 * (begin + end)[:, None] * directions[ray]
    around = [_around(p[1:-1], m) for p, m in zip(planes, middle.T, strict=True)]
    lower, upper, pitch, corner = (np.array(rows) for rows in zip(*around, strict=True))
    along = Along(fields, lower, upper, pitch, corner, origins[ray].T, directions[ray].T)
    return ray, along, begin, end


def _between_faces(edges, origins, directions):
    low, high = (np.array([e[k] for e in edges]) for k in (0, -1))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        a, b = (low - origins) / directions, (high - origins) / directions
    within = (origins >= low) & (origins <= high)
    first, last = np.minimum(a, b), np.maximum(a, b)
    first = np.where(directions == 0, np.where(within, -np.inf, np.inf), first)
    last = np.where(directions == 0, np.where(within, np.inf, -np.inf), last)
    return first.max(axis=1), last.min(axis=1)


def _around(centers, x):
    """Return the centres below and above x: the same one twice beyond the outermost."""
    below = np.searchsorted(centers, x, side="right") - 1
    lower, upper = np.maximum(below, 0), np.minimum(below + 1, len(centers) - 1)
    apart = centers[upper] - centers[lower]
    pitch = np.where(apart > 0, 1.0 / np.where(apart > 0, apart, 1.0), 0.0)
    return lower, upper, pitch, centers[lower]


def _cut(parts, ray, along, begin, end) -> Panels:
    """Cut pieces where scalars turn round, and where they pass values that parts name."""
    pieces = np.arange(len(ray))
    cuts = [(pieces, begin), (pieces, end)]
    events = []
    for number, part in enumerate(parts):
        if part.scalar is None:
            continue
        owner, low, high = _monotonic(part.scalar, along, begin, end)
        cuts.append((owner, low))
        crossing = isinstance(part, Surface) and part.width == 0.0
        values = part.values[:1] if crossing else part.values
        for value in values:
            where, t = _passes(part.scalar, value, along, owner, low, high)
            cuts.append((where, t))
            if crossing:
                events.append((where, t, np.full(len(t), number)))
    piece, t = (np.concatenate(column) for column in zip(*cuts, strict=True))
    order = np.lexsort((t, piece))
    piece, t = piece[order], t[order]
    real = (piece[1:] == piece[:-1]) & (t[1:] > t[:-1])
    owner = piece[:-1][real]
    panels = Panels(ray[owner], owner, t[:-1][real], t[1:][real], np.full(len(owner), -1))
    for where, t, number in events:
        panels = panels.joined(Panels(ray[where], where, t, t, number))
    return panels


def _monotonic(scalar, along, begin, end):
    """Return the parts of pieces over which a scalar rises or falls: owner, begin, end."""
    share = np.linspace(0.0, 1.0, _LOOKS)
    t = begin[:, None] + (end - begin)[:, None] * share
    rising = _slope(scalar, along, t) > 0
    owner, column = np.nonzero(rising[:, 1:] != rising[:, :-1])
    low, high = t[owner, column], t[owner, column + 1]
    pieces, up = along.take(owner), rising[owner, column]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        same = (_slope(scalar, pieces, middle) > 0) == up
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    everyone = np.arange(len(begin))
    piece = np.concatenate([everyone, owner, everyone])
    turns = np.concatenate([begin, 0.5 * (low + high), end])
    order = np.lexsort((turns, piece))
    piece, turns = piece[order], turns[order]
    real = piece[1:] == piece[:-1]
    return piece[:-1][real], turns[:-1][real], turns[1:][real]


def _slope(scalar, along, t):
    return scalar(along.fields(t + 1j * _STEP)).imag


def _passes(scalar, value, along, owner, low, high):
    """Return where a monotonic scalar passes a value: owner and distance."""
    pieces = along.take(owner)
    before = scalar(pieces.fields(low)) < value
    index = np.flatnonzero(before != (scalar(pieces.fields(high)) < value))
    pieces, before, low, high = pieces.take(index), before[index], low[index], high[index]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        same = (scalar(pieces.fields(middle)) < value) == before
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return owner[index], 0.5 * (low + high)


def _refined(parts, panels: Panels, along: Along) -> Panels:
    """Halve panels until both halves together say what the whole says."""
    accuracy = max([_ACCURACY, *(_NOISE * getattr(part, "steepness", 0.0) for part in parts)])
    done = panels.take(np.flatnonzero(panels.event >= 0))
    extent = panels.take(np.flatnonzero(panels.event < 0))
    for _ in range(_ROUNDS):
        b, depth = _solve(parts, extent, along)
        middle = 0.5 * (extent.begin + extent.end)
        halves = Panels(*(np.repeat(a, 2) for a in vars(extent).values()))
        halves.end[0::2], halves.begin[1::2] = middle, middle
        (bn, bf), (dn, df) = ((v[:, 0::2], v[:, 1::2]) for v in _solve(parts, halves, along))
        ahead = np.exp(-_depth_before(extent, depth))
        fine = bn + np.exp(-dn) * bf
        wrong = np.abs(b - fine) * ahead > accuracy * np.abs(fine * ahead).max(initial=1e-300)
        deep = np.abs(depth - dn - df) > accuracy * depth.max(initial=1e-300)
        blind = (depth > _DEEPEST) & (ahead > _UNSEEN)
        wrong = (wrong | deep | blind).any(axis=0) & (middle > extent.begin) & (middle < extent.end)
        done = done.joined(extent.take(np.flatnonzero(~wrong)))
        if not wrong.any():
            return done
        extent = halves.take(np.flatnonzero(np.repeat(wrong, 2)))
    raise AssertionError("the twin's quadrature does not converge")


def _depth_before(panels: Panels, depth: np.ndarray) -> np.ndarray:
    """Return the optical depth of panels of the same ray in front of each (those that remain)."""
    total = np.cumsum(depth, axis=1) - depth
    first = np.searchsorted(panels.ray, panels.ray)
    return np.maximum(total - total[:, first], 0.0)


def _rule() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes on (0, 1), weights, and the matrix that integrates from 0 to each node."""
    node, weight = np.polynomial.legendre.leggauss(NODES)
    legendre = np.polynomial.legendre.legvander(node, NODES)
    # An antiderivative of P_k that vanishes at -1: (P_{k+1} - P_{k-1}) / (2 k + 1).
    anti = np.empty((NODES, NODES))
    anti[:, 0] = node + 1
    for k in range(1, NODES):
        anti[:, k] = (legendre[:, k + 1] - legendre[:, k - 1]) / (2 * k + 1)
    fit = legendre[:, :NODES].T * weight * (np.arange(NODES)[:, None] + 0.5)
    return 0.5 * (node + 1), 0.5 * weight, 0.5 * anti @ fit


def _solve(parts, panels: Panels, along: Along) -> tuple[np.ndarray, np.ndarray]:
    """Return what panels emit towards their begin, and their depth; shape (channel, N)."""
    node, weight, integral = _rule()
    width = (panels.end - panels.begin)[:, None]
    t = panels.begin[:, None] + width * node
    pieces = along.take(panels.piece)
    extended = [p for p in parts if not (isinstance(p, Surface) and p.width == 0.0)]
    if not extended:
        zero = np.zeros((len(parts[0].color), len(t)))
        return zero, zero
    j, alpha = sum(part(pieces, t) for part in extended)
    depth = width * (alpha @ integral.T)
    b = (width * j * np.exp(-depth)) @ weight
    return b, (width * alpha) @ weight


def _fold(parts, panels: Panels, along: Along, rays: int, background: float):
    """Compose what is seen of all panels, front to back."""
    b, depth = (a.copy() for a in _solve(parts, panels, along))
    for number in np.unique(panels.event[panels.event >= 0]):
        crossed, part = panels.event == number, parts[number]
        opacity = np.asarray(part.opacity, float)[:, None]
        b[:, crossed] = np.asarray(part.color, float)[:, None] * opacity
        depth[:, crossed] = -np.log1p(-opacity)
    # Depths are added ray by ray: differences of one running sum would lose digits.
    result = {k: np.zeros((rays, len(b))) for k in ("intensity", "optical_depth")}
    for ray, index in _by_ray(panels.ray):
        ahead = np.cumsum(depth[:, index], axis=1)
        seen = np.exp(-(ahead - depth[:, index]))
        result["intensity"][ray] = (b[:, index] * seen).sum(axis=1)
        result["optical_depth"][ray] = ahead[:, -1]
    result["transparency"] = np.exp(-result["optical_depth"])
    result["intensity"] += background * result["transparency"]
    return result


def _by_ray(ray):
    present, first = np.unique(ray, return_index=True)
    return zip(present, np.split(np.arange(len(ray)), first[1:]), strict=True)
