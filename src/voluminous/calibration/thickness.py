"""Median thicknesses of shells of a scalar in a volume."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..digest import digest
from ..errors import InputError
from ..expressions import Expression
from ..grids.cartesian.grid import CartesianGrid
from ..volume import Volume
from .samples import BUDGET, Run, between_centers, lines, of_runs

# A profile is evaluated at a single value in cells whose values differ by less than this part of
# its effective width.
_NARROW = 1e-3
# Cells that contain less of the shell than this part of the largest possible amount do not count.
_NOTICEABLE = 0.01
# A line has met a shell where it sees this part of its median thickness.
_MET = 0.3
# Of more values a histogram of so many bins brackets the median: a sixth of the time of sorting.
_MANY, _BINS = 1 << 16, 256


class Profile:
    """Heights h ≥ 0 at increasing nodes, linear in between, zero outside; scaled to a peak of one.

    Two equal nodes make a jump. The effective `width` ∫ h dx / max h is zero if nothing shows; the
    `key` is a hash of nodes and heights.
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

        A shell thinner than a cell shows in the cells it crosses, not only at their centres.
        """
        out = np.zeros(x.shape)
        near = (x + reach >= self.nodes[0]) & (x - reach <= self.nodes[-1])
        x, reach = x[near].astype(np.float64), reach[near].astype(np.float64)
        wide = reach > _NARROW * self.width
        half = np.where(wide, reach, 1.0)  # twice as much may overflow
        means = 0.5 * (self._integral(x + reach) - self._integral(x - reach)) / half
        means[~wide] = np.interp(x[~wide], self.nodes, self.heights)
        out[near] = means
        return out

    def _integral(self, x: np.ndarray) -> np.ndarray:
        x = np.clip(x, self.nodes[0], self.nodes[-1])
        k = np.clip(np.searchsorted(self.nodes, x, "right") - 1, 0, len(self.nodes) - 2)
        d = x - self.nodes[k]
        return np.asarray(self._areas[k] + d * (self.heights[k] + 0.5 * self._slopes[k] * d))


@dataclass
class Thickness:
    """Median thickness of a shell in the volume's unit, crossings, and area in an arbitrary unit.

    `crossings` is the mean number of thicknesses that lines along an axis (y or z of Cartesian
    grids) see, of those that see the shell; zero if none does.
    """

    length: float
    crossings: float
    area: float


@dataclass
class _Shell:
    """A profile, the thicknesses of cells, their areas, and the lengths that lines see."""

    profile: Profile
    thickest: float
    lengths: list[np.ndarray] = field(default_factory=list)
    areas: list[np.ndarray] = field(default_factory=list)
    seen: list[np.ndarray] = field(default_factory=list)

    @property
    def area(self) -> float:
        return float(sum(areas.sum() for areas in self.areas))

    def see(self, samples: Run) -> None:
        mean = self.profile.mean(samples.x, samples.reach)
        self.seen += [seen[seen > 0] for seen in samples.lengths_along_lines(mean)]

    def add(self, lengths: np.ndarray, areas: np.ndarray, seen: list[np.ndarray]) -> None:
        self.lengths.append(lengths)
        self.areas.append(areas)
        self.seen += seen

    def part(self, samples: Run) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Return the thicknesses of some cells, their areas, and the lengths that lines see."""
        width, mean = self.profile.width, self.profile.mean(samples.x, samples.reach)
        # The largest possible mean, where a cell is steeper than the shell is wide.
        most = width / np.maximum(width, 2 * samples.reach)
        inside = mean > _NOTICEABLE * most
        slope = samples.slope[inside].astype(np.float64)
        thin = slope * self.thickest > width
        length = np.divide(width, slope, out=np.full(len(slope), self.thickest), where=thin)
        volume = np.broadcast_to(samples.volume, mean.shape)[inside]
        seen = [seen[seen > 0] for seen in samples.lengths_along_lines(mean)]
        return length, mean[inside] * volume / length, seen

    def measured(self, scale: float) -> Thickness:
        if not self.area:
            return Thickness(self.thickest * scale, 0.0, 0.0)
        length = weighted_median(np.concatenate(self.lengths), np.concatenate(self.areas))
        seen = np.concatenate(self.seen) if self.seen else np.empty(0)
        met = seen[seen > _MET * length]
        crossings = float(met.mean() / length) if len(met) else 0.0
        return Thickness(length * scale, crossings, self.area)


def thicknesses(
    volume: Volume, expr: Expression, profiles: Sequence[Profile], budget: int = BUDGET
) -> list[Thickness]:
    """Return the median thickness of shells of one scalar x in a volume.

    Where x has the gradient ∇x, a shell of effective width w (`Profile.width`) in x is w / |∇x|
    thick, or as thick as the shortest side L of the domain if that is less (a volume filled with
    the shell, seen along that side, shows its colour). Each cell that the shell goes through counts
    with the area it contributes to the shell, volume times mean profile over thickness, so the
    median is that of the lines of sight that cross the shell. Where a field jumps from one cell to
    the next, no cell shows the shell, and the space between their centres counts.

    Notes
    -----
    The area follows from the coarea formula, ∫ f |∇x| dV = ∫ dx ∫ f dA.
    """
    grid = volume.grid
    thickest = float(np.ptp(grid.bounds, axis=1).min() / grid.scale)
    shells = [_Shell(profile, thickest) for profile in profiles]
    visible = [shell for shell in shells if shell.profile.width > 0]
    _measure(volume, expr, visible, budget)
    missed = [shell for shell in visible if not shell.area]
    if missed and grid.size > budget:  # perhaps between the layers that were sampled
        _measure(volume, expr, missed, np.inf)
    missed = [shell for shell in missed if not shell.area]
    for samples in between_centers(volume, expr) if missed else ():
        for shell in missed:
            shell.add(*shell.part(samples))
    measured = [shell.measured(grid.scale) for shell in shells]
    if not all(0.0 < shell.length < np.inf for shell in measured):
        raise InputError(
            f"how thick a shell of {expr.text} is cannot be measured in this volume: its gradient "
            "is too large for double precision. Take another unit for the field, or give "
            "path_length"
        )
    return measured


def _measure(volume: Volume, expr: Expression, shells: Sequence[_Shell], budget: float) -> None:
    def measured(run: Run) -> list[tuple[np.ndarray, np.ndarray, list[np.ndarray]]]:
        return [shell.part(run) for shell in shells]

    for parts in of_runs(measured, volume, expr, budget):
        for shell, part in zip(shells, parts, strict=True):
            shell.add(*part)
    if shells and not isinstance(volume.grid, CartesianGrid):
        along = lines(volume, expr)
        for shell in shells:
            shell.see(along)


def weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    """Return the least value that, with all below it, has at least half of the weight."""
    below, total = 0.0, 0.0
    if len(values) > _MANY:  # only those near it are sorted
        total = float(weights.sum())
        amounts, edges = np.histogram(values, _BINS, weights=weights)
        k = min(int(np.searchsorted(np.cumsum(amounts), 0.5 * total)), _BINS - 1)
        below = float(weights[values < edges[k]].sum())
        near = (values >= edges[k]) & (values <= edges[k + 1])
        values, weights = values[near], weights[near]
    order = np.argsort(values, kind="stable")
    reached = below + np.cumsum(weights[order])
    place = np.searchsorted(reached, 0.5 * (total or reached[-1]))
    return float(values[order[min(int(place), len(order) - 1)]])
