"""Components of vectors that are given by others: along x, y, z, r, θ, φ, R, or the line of sight.

A vector is three fields: ``name_x, name_y, name_z``, or ``name_r, name_theta, name_phi``, or
``name_R, name_phi, name_z``. All that is needed to turn one into another is in the cell itself.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, UnitsError
from ..expressions import DerivedField, Expression
from ..geometry import CARTESIAN, CYLINDRICAL, SPHERICAL, turns
from ..grids.contract import basis
from ..units import unit_name

if TYPE_CHECKING:
    from ..grids.contract import Grid

_SYSTEMS = (CARTESIAN, SPHERICAL, CYLINDRICAL)
_CHUNK = 1 << 20


def component(name: str, fields: Container[str], grid: Grid) -> DerivedField | None:
    """Return what a component such as ``velocity_x`` is made of, None if that is not there."""
    stem, _, axis = name.rpartition("_")
    if not stem or not any(axis in system for system in _SYSTEMS):
        return None
    for system in (grid.coordinates, *_SYSTEMS):
        parts = [f"{stem}_{own}" for own in system]
        if all(part in fields for part in parts):
            return DerivedField(name, f"along.{axis}", tuple(Expression(p) for p in parts))
    return None


def is_component(derived: DerivedField) -> bool:
    """Return True for components of vectors and values of cells, False for derivatives."""
    return derived.operation in ("los", "cellwise") or derived.operation.startswith("along.")


def component_everywhere(volume: Any, derived: DerivedField) -> np.ndarray:
    """Return a component in all cells: float32 if the vector is, else float64."""
    size = volume.grid.size
    parts = [
        component_of_cells(volume, derived, first, min(first + _CHUNK, size))
        for first in range(0, size, _CHUNK)
    ]
    return np.asarray(np.concatenate(parts).reshape(volume.grid.shape))


def component_of_cells(volume: Any, derived: DerivedField, first: int, last: int) -> np.ndarray:
    """Return a component in consecutive cells."""
    _, factors = common_unit(volume, derived)
    given = [volume.evaluate_cells(argument, first, last) for argument in derived.arguments]
    onto = _directions(volume, derived, first, last)
    found = sum(f * v * d for f, v, d in zip(factors, given, onto, strict=True))
    single = all(values.dtype == np.float32 for values in given)
    return np.asarray(found, np.float32 if single else np.float64)


def _directions(volume: Any, derived: DerivedField, first: int, last: int) -> Sequence[np.ndarray]:
    """Return the cosines between a vector's components and the one that is asked for, (3, n)."""
    grid = volume.grid
    if derived.operation == "cellwise":
        return [np.ones(1)]
    if derived.operation == "los":
        return list(volume.sight.directions(first, last))
    system = [argument.text.rpartition("_")[2] for argument in derived.arguments]
    onto = _unit_vector(grid, derived.operation.partition(".")[2], first, last)
    return [np.sum(_unit_vector(grid, own, first, last) * onto, axis=0) for own in system]


def sight_cosines(volume: Any, axis: str, first: int, last: int) -> np.ndarray:
    """Return the cosines between an axis and the line of sight, away from the observer."""
    onto = np.asarray(volume.sight.directions(first, last))
    return np.asarray(np.sum(_unit_vector(volume.grid, axis, first, last) * onto, axis=0))


def common_unit(volume: Any, derived: DerivedField) -> tuple[Any, list[float]]:
    """Return the unit of a vector, None if it has none, and what its components are times.

    A component that is 0 needs no unit.
    """
    units = [volume.expression_unit(argument) for argument in derived.arguments]
    own = next((unit for unit in units if unit is not None), None)
    if own is None:
        return None, [1.0] * len(units)
    from astropy import units as u

    zero = Expression(0)
    given = [own if e == zero else unit for e, unit in zip(derived.arguments, units, strict=True)]
    try:
        factors = [float((unit or u.dimensionless_unscaled).to(own)) for unit in given]
    except u.UnitConversionError as error:
        listed = ", ".join(
            f"{argument.text} in {unit_name(unit) or 'no unit'}"
            for argument, unit in zip(derived.arguments, units, strict=True)
        )
        raise UnitsError(
            f"the components of a vector must have units of one kind, got {listed}; "
            "use volume.set_unit(...), or multiply angular velocities by their radius"
        ) from error
    return own, factors


def _unit_vector(grid: Grid, axis: str, first: int, last: int) -> np.ndarray:
    """Return the direction in which a coordinate increases, at cell centres, shape (3, n).

    Zero where it has none: along r in the origin, along R, θ and φ on the axis.
    """
    if axis in CARTESIAN:
        return np.broadcast_to(np.eye(3)[CARTESIAN.index(axis)][:, None], (3, last - first))
    if axis in grid.coordinates:
        return np.asarray(basis(grid, first, last)[grid.coordinates.index(axis)])
    x, y, z = grid.cell_centers(first, last)
    zero = np.zeros_like(x)
    match axis:
        case "r":
            return _normalised(np.array([x, y, z]))
        case "R":
            return _normalised(np.array([x, y, zero]))
        case "phi":
            return _normalised(np.array([-y, x, zero]))
    return _normalised(np.array([x * z, y * z, -(x * x + y * y)]))  # θ


def _normalised(vectors: np.ndarray) -> np.ndarray:
    length = np.sqrt(np.sum(vectors * vectors, axis=0))
    return np.asarray(vectors / np.where(length > 0, length, 1.0))


# Cosines that differ by less are alike: what rounding does to them, and far less than is seen.
_ALIKE = 1e-9


class LinesOfSight:
    """Lines of sight of a camera, None if none is known, through the cells of a grid."""

    def __init__(self, grid: Grid, camera: Any = None) -> None:
        self.grid, self.camera = grid, camera

    def directions(self, first: int, last: int) -> np.ndarray:
        """Return unit vectors from the observer to the centres of cells, shape (3, n)."""
        if self.camera is None:
            raise InputError(
                "los(...) needs to know from where the volume is seen; "
                "give a camera: volume.evaluate(..., camera=camera)"
            )
        if self.grid.mirror:
            raise InputError(
                "los(...) differs between a cell and its mirror image: volume.unfolded() has both"
            )
        if getattr(self.camera, "parallel", False) and not turns(self.grid):
            # Where cells are would take ten times as long as all else.
            return np.broadcast_to(self._to(np.zeros((3, 1))), (3, last - first))
        centers = self.grid.cell_centers(first, last)
        found = self._to(centers)
        self._check_around(centers, found)
        return found

    def _check_around(self, centers: np.ndarray, found: np.ndarray) -> None:
        """Refuse cells that go around the axis, or the centre, and look different from there.

        Seen from the axis, or along it, they look the same on all sides, whichever way they move.
        """
        for turn in turns(self.grid):
            if not np.allclose(self._to(turn @ centers), turn @ found, rtol=0, atol=_ALIKE):
                raise InputError(
                    "los(...) differs along a cell that goes all around: volume.unfolded(phi=64) "
                    "has many in its place, which tell directions apart (where a grid is refined, "
                    "volume.resample(grid) onto one that is not); "
                    "components in the grid's own coordinates keep their values"
                )

    def key(self) -> bytes | None:
        """Return what lines of sight depend on: those to the corners of the domain tell."""
        if self.camera is None:
            return None
        corners = np.array(np.meshgrid(*self.grid.bounds, indexing="ij")).reshape(3, -1)
        return self._to(corners).tobytes()

    def _to(self, points: np.ndarray) -> np.ndarray:
        return np.asarray(self.camera.lines_of_sight(points, self.grid))
