"""Two histograms of a scalar over a volume: how much there is of a value, and how steep it is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..digest import digest
from ..errors import InputError
from ..expressions import Expression
from ..volume import Volume
from .samples import BUDGET, Between, LayerPiece, LineSamples, ScatteredPiece, lines, pieces

if TYPE_CHECKING:
    from ..grids.contract import Grid

# Up to this part of the effective width a cell sees a single value of the profile.
_NARROW = 1e-3


class Profile:
    """Heights h ≥ 0 at increasing nodes, linear in between, zero outside; the greatest is one.

    Parameters
    ----------
    nodes : array, shape (n,)
        Values of x; two equal ones make a jump.
    heights : array, shape (n,)
        The profile there, in any unit.

    Attributes
    ----------
    width : float
        Effective width ∫ h dx / max h; zero if nothing shows.
    key : bytes
        A hash of nodes and heights: what identifies it.
    """

    def __init__(self, nodes: np.ndarray, heights: np.ndarray) -> None:
        peak = float(heights.max())
        self.nodes = np.asarray(nodes, dtype=np.float64)
        self.heights = heights / peak if peak > 0 else np.zeros(len(nodes))
        steps, rises = np.diff(self.nodes), np.diff(self.heights)
        areas = steps * (self.heights[:-1] + 0.5 * rises)
        self._slopes = np.divide(rises, steps, out=np.zeros(len(steps)), where=steps > 0)
        self._areas = np.concatenate([[0.0], np.cumsum(areas)])
        self.width = float(self._areas[-1])
        self.key = digest(np.concatenate([self.nodes, self.heights]))

    def mean(self, x: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Return the mean of the profile from x - reach to x + reach; zero where x is NaN.

        A shell that is thinner than a cell is seen by the cells it goes through, whether or not it
        meets their centres.
        """
        out = np.zeros(x.shape)
        near = (x + reach >= self.nodes[0]) & (x - reach <= self.nodes[-1])
        x, reach = x[near].astype(np.float64), reach[near].astype(np.float64)
        wide = reach > _NARROW * self.width
        found = np.interp(x, self.nodes, self.heights)
        half = np.where(wide, reach, 1.0)  # twice as much may be no number
        means = 0.5 * (self._integral(x + reach) - self._integral(x - reach)) / half
        out[near] = np.where(wide, means, found)
        return out

    def _integral(self, x: np.ndarray) -> np.ndarray:
        x = np.clip(x, self.nodes[0], self.nodes[-1])
        k = np.clip(np.searchsorted(self.nodes, x, "right") - 1, 0, len(self.nodes) - 2)
        d = x - self.nodes[k]
        return self._areas[k] + d * (self.heights[k] + 0.5 * self._slopes[k] * d)


# Cells that see less of the shell than this part of what they could see do not count.
_NOTICEABLE = 0.01
# A line along the grid has met a shell where it sees this part of its median thickness.
_MET = 0.3


@dataclass
class Thickness:
    """What was measured of one shell.

    Attributes
    ----------
    length : float
        Median thickness, in the volume's unit.
    crossings : float
        Mean number of thicknesses that a line along an axis sees (along y or z of Cartesian grids),
        of those that see the shell; zero if none does.
    area : float
        Area of the shell in what was looked at, in an arbitrary unit.
    """

    length: float
    crossings: float
    area: float


def thicknesses(volume: Volume, expr: Expression, profiles: Sequence[Profile]) -> list[Thickness]:
    """Return the median thickness of shells of one scalar x in a volume.

    Where x has the gradient ∇x, a shell of effective width w (`Profile.width`) in x is w / |∇x|
    thick, or as thick as the shortest side L of the domain if that is less (a volume filled with
    the shell, seen along that side, shows its colour). Each cell that the shell goes through counts
    with the area it contributes to the shell, volume times mean profile over thickness, so the
    median is that of the lines of sight that cross the shell. Where the gradients of cells do not
    show it, since a field jumps from one cell to the next, what is between their centres counts.

    Notes
    -----
    The area follows from the coarea formula, ∫ f |∇x| dV = ∫ dx ∫ f dA.
    """
    found = _measure(volume, expr, profiles, BUDGET)
    missed = [k for k, shell in enumerate(found) if not shell.area]
    if missed and volume.grid.size > BUDGET:  # perhaps between the layers that were looked at
        again = _measure(volume, expr, [profiles[k] for k in missed], np.inf)
        for k, shell in zip(missed, again, strict=True):
            found[k] = shell
    missed = [k for k in missed if not found[k].area and profiles[k].width > 0]
    _look_between(volume, expr, [(found[k], profiles[k]) for k in missed])
    scale, longest = volume.grid.scale, _shortest_side(volume)
    measured = [shell.measured(longest, scale) for shell in found]
    if not all(0.0 < shell.length < np.inf for shell in measured):
        raise InputError(
            f"how thick a shell of {expr.text} is cannot be measured in this volume: its gradient "
            "is too large for double precision. Take another unit for the field, or give "
            "path_length"
        )
    return measured


@dataclass
class _Shell:
    """Thicknesses of cells, the areas they count with, and lengths that lines see."""

    lengths: list[np.ndarray] = field(default_factory=list)
    areas: list[np.ndarray] = field(default_factory=list)
    seen: list[np.ndarray] = field(default_factory=list)

    @property
    def area(self) -> float:
        return float(sum(areas.sum() for areas in self.areas))

    def see(self, found: LineSamples, profile: Profile) -> None:
        seen = found.seen(profile.mean(found.x, found.reach))
        self.seen.append(seen[seen > 0])

    def add(
        self, piece: LayerPiece | ScatteredPiece | Between, profile: Profile, longest: float
    ) -> None:
        mean = profile.mean(piece.x, piece.reach)
        # The most there can be, where a cell is steeper than the shell is wide.
        most = profile.width / np.maximum(profile.width, 2 * piece.reach)
        inside = mean > _NOTICEABLE * most
        slope = piece.slope[inside].astype(np.float64)
        thin = slope * longest > profile.width
        length = np.divide(profile.width, slope, out=np.full(len(slope), longest), where=thin)
        volume = np.broadcast_to(piece.volume, mean.shape)[inside]
        self.lengths.append(length)
        self.areas.append(mean[inside] * volume / length)
        self.seen += [seen[seen > 0] for seen in piece.seen(mean)]

    def measured(self, longest: float, scale: float) -> Thickness:
        if not self.area:
            return Thickness(longest * scale, 0.0, 0.0)
        length = weighted_median(np.concatenate(self.lengths), np.concatenate(self.areas))
        seen = np.concatenate(self.seen)
        met = seen[seen > _MET * length]
        crossings = float(met.mean() / length) if len(met) else 0.0
        return Thickness(length * scale, crossings, self.area)


def weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    """Return the least value that, with all below it, has at least half of the weight."""
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(reached, 0.5 * reached[-1])]])


def _measure(
    volume: Volume, expr: Expression, profiles: Sequence[Profile], budget: float
) -> list[_Shell]:
    shells = [_Shell() for _ in profiles]
    longest = _shortest_side(volume)
    for piece in pieces(volume, expr, budget):
        for shell, profile in zip(shells, profiles, strict=True):
            if profile.width > 0:
                shell.add(piece, profile, longest)
    if not volume.grid.is_rectilinear:  # its pieces are lines already
        found = lines(volume, expr)
        for shell, profile in zip(shells, profiles, strict=True):
            if profile.width > 0:
                shell.see(found, profile)
    return shells


def _look_between(
    volume: Volume, expr: Expression, shells: Sequence[tuple[_Shell, Profile]]
) -> None:
    """Look from one cell to the next: a field with two values has no others in its cells."""
    longest = _shortest_side(volume)
    for between in _between(volume, expr) if shells else ():
        for shell, profile in shells:
            shell.add(between, profile, longest)


def _between(volume: Volume, expr: Expression) -> Iterator[Between]:
    for piece in pieces(volume, expr):
        if not isinstance(piece, LayerPiece):
            found = lines(volume, expr)
            yield Between(found.x, found.reach, 2 * found.reach / found.length, found.length)
            return
        yield from piece.between()


def _shortest_side(volume: Volume) -> float:
    return float(np.ptp(volume.grid.bounds, axis=1).min() / volume.grid.scale)


_BINS = 1024
# What the histogram spans of the values: all but a few, so that one odd cell does not coarsen it.
_LEAST, _GREATEST = 1e-4, 1 - 1e-5
# Bins are told apart in double precision if they are this much of the values, or wider.
_DIGITS = 2.0**-50
# Enough values for such quantiles.
_VALUES = 1 << 20


@dataclass
class Histogram:
    """Sums over cells, in bins of equal width.

    Attributes
    ----------
    edges : array, shape (n + 1,)
        Of the bins, in x.
    volume : array, shape (n,)
        Volume of the cells in a bin, as a part of the domain.
    area : array, shape (n,)
        Mean area of the isosurfaces in a bin, in squares of the domain's diagonal: the sum of
        |∇x| dV over the width of the bin (the coarea formula).
    """

    edges: np.ndarray
    volume: np.ndarray
    area: np.ndarray

    @property
    def centers(self) -> np.ndarray:
        """The middles of the bins."""
        return 0.5 * (self.edges[1:] + self.edges[:-1])

    def steepness(self, smoothing: float) -> np.ndarray:
        """Return the mean |∇x| as a function of x, smoothed over a length in x; zero without data.

        Its peaks are the boundaries of materials: Kindlmann & Durkin (1998), "Semi-automatic
        generation of transfer functions for direct volume rendering", section 4.
        """
        step = self.edges[1] - self.edges[0]
        reach = int(np.ceil(3 * smoothing / step))
        offsets = np.arange(-reach, reach + 1) * step / smoothing
        kernel = np.exp(-0.5 * offsets**2)
        amount, steep = (
            np.convolve(v, kernel)[reach : reach + len(v)] for v in (self.volume, self.area)
        )
        enough = amount > 1e-12 * amount.max()
        return np.divide(steep, amount, out=np.zeros(len(steep)), where=enough)


def sampled_values(volume: Volume, expr: Expression) -> np.ndarray:
    """Return finite values of an expression, about a million of them, evenly spread and sorted."""
    step = max(1, min(volume.grid.size, BUDGET) // _VALUES)
    # An odd number that divides no usual side: a step along all three axes, not along one.
    step += step > 1 and step % 2 == 0
    found = [piece.x.ravel()[::step] for piece in pieces(volume, expr)]
    values = np.concatenate(found)
    return np.sort(values[~np.isnan(values)])


def is_constant(low: float, high: float) -> bool:
    """Return True if what lies between two values is rounding: bins cannot tell them apart."""
    return not high - low > _BINS * _DIGITS * max(abs(low), abs(high))


def _range(values: np.ndarray) -> tuple[float, float]:
    """Return what a histogram spans of sorted values: without odd ones, if others differ."""
    last = len(values) - 1
    low, high = (float(values[k]) for k in (math.ceil(_LEAST * last), int(_GREATEST * last)))
    return (float(values[0]), float(values[-1])) if is_constant(low, high) else (low, high)


def histogram(volume: Volume, expr: Expression, values: np.ndarray) -> Histogram:
    """Return the histogram of an expression over the range of `values` (sorted, not constant)."""
    low, high = _range(values)
    cells, steep, total = np.zeros(_BINS), np.zeros(_BINS), 0.0
    for piece in pieces(volume, expr):
        inside = (piece.x >= low) & (piece.x <= high)
        x = piece.x[inside]
        size = np.broadcast_to(piece.volume, inside.shape)[inside]
        total += float(np.broadcast_to(piece.volume, inside.shape).sum())
        cells += np.histogram(x, _BINS, (low, high), weights=size)[0]
        steep += np.histogram(x, _BINS, (low, high), weights=piece.slope[inside] * size)[0]
    sides = np.ptp(volume.grid.bounds, axis=1) / volume.grid.scale
    # What was left out counts like what was looked at.
    per_area = _domain(volume.grid) / total / float(np.sum(sides**2))
    edges = np.linspace(low, high, _BINS + 1)
    return Histogram(edges, cells / total, steep / (high - low) * (per_area * _BINS))


def _domain(grid: Grid) -> float:
    if grid.is_rectilinear:
        return float(np.prod(np.ptp(grid.bounds, axis=1) / grid.scale))
    return float(np.sum(grid.cell_volumes)) / grid.scale**3
