"""How thick a shell is in a volume, and how often a line of sight crosses it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..volume import Volume
from .profile import Profile
from .samples import BUDGET, Between, Piece, pieces
from .scattered import Lines, ScatteredPiece, lines

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

    Parameters
    ----------
    volume : Volume
        Where x is looked at; of large ones, evenly spread parts.
    expr : Expression
        The scalar x.
    profiles : sequence of Profile
        The shells.

    Returns
    -------
    list of Thickness
        For a shell that is nowhere in the volume, the shortest side.

    Raises
    ------
    InputError
        If gradients are too large for double precision.

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

    def see(self, found: Lines, profile: Profile) -> None:
        seen = found.seen(profile.mean(found.x, found.reach))
        self.seen.append(seen[seen > 0])

    def add(
        self, piece: Piece | ScatteredPiece | Between, profile: Profile, longest: float
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
        if not isinstance(piece, Piece):
            found = lines(volume, expr)
            yield Between(found.x, found.reach, 2 * found.reach / found.length, found.length)
            return
        yield from piece.between()


def _shortest_side(volume: Volume) -> float:
    return float(np.ptp(volume.grid.bounds, axis=1).min() / volume.grid.scale)
