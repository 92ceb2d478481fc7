"""Derived fields of a volume, computed at first use and cached."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import InputError
from ..expressions import DerivedField, Expression, is_dex, required_names
from ..grids.contract import BoxGrid
from ..grids.structured import is_structured
from ..grids.trees.vertices import LeafGrid
from ..memory import fits
from ..units import parse_unit
from .neighbours import NeighbourDifferences
from .structured import in_single, whole
from .tree_slopes import BoxesOfTree
from .vectors import common_unit, component_everywhere, is_component

if TYPE_CHECKING:
    from ..grids.contract import Grid


def differentiated(volume: Any, operation: str, argument: Expression) -> np.ndarray:
    """Return a derivative of an expression in all cells, in units of the grid's length."""
    if not isinstance(volume.grid, BoxGrid):
        raise InputError(
            f"{operation} needs cells that are boxes, got a {type(volume.grid).__name__}; resample "
            "the volume first: volume.resample(vm.CartesianGrid.uniform(...))"
        )
    if is_structured(volume.grid):
        return _along_axes(volume, operation, argument)

    def cells(first: int, last: int) -> np.ndarray:
        return np.asarray(volume.evaluate_cells(argument, first, last))

    found = differences(volume.grid, cells).derivative(operation).reshape(volume.grid.shape)
    single = cells(0, 1).dtype == np.float32 and in_single(found)
    return np.asarray(found.astype(np.float32) if single else found)


def differences(
    grid: Grid, evaluate: Callable[[int, int], np.ndarray]
) -> NeighbourDifferences | BoxesOfTree:
    """Return the object that differentiates on unstructured grids; trees use kernels."""
    return (BoxesOfTree if isinstance(grid, LeafGrid) else NeighbourDifferences)(grid, evaluate)


def _along_axes(volume: Any, operation: str, argument: Expression) -> np.ndarray:
    grid = volume.grid
    _, n2, n3 = grid.shape

    def layers(part: slice) -> np.ndarray:
        values = volume.evaluate_cells(argument, part.start * n2 * n3, part.stop * n2 * n3)
        return np.asarray(values.reshape(-1, n2, n3))

    return whole(operation, layers, grid)


# Bytes per cell of memory that cached derivatives must leave free.
_SPARE = 16


class _Kept(NamedTuple):
    array: np.ndarray
    # The fields it was computed from, and a hash of each.
    source: dict[str, bytes]
    # Key of the camera, if the array depends on it.
    view: bytes | None


class Derivatives:
    """Cache of a volume's derivatives and vector components.

    Each method takes the volume as an argument: a reference to it would be a cycle, and the volume
    would stay in memory until Python's garbage collector runs.
    """

    def __init__(self) -> None:
        self._kept: dict[str, _Kept] = {}

    def array(self, volume: Any, derived: DerivedField) -> np.ndarray:
        """Return the values, float32 or float64, in `unit`."""
        view = volume.sight.key() if "los(" in derived.name else None
        cached = self._kept.get(derived.name)
        if cached is None or cached.view != view:
            with np.errstate(all="ignore"):  # NaN and infinity show in the result
                if is_component(derived):
                    array = component_everywhere(volume, derived)
                else:
                    array = differentiated(volume, derived.operation, derived.arguments[0])
            names = {n for a in derived.arguments for n in required_names(a)}
            source = {name: volume.digest(name) for name in volume.given(names)}
            cached = self._kept[derived.name] = _Kept(array, source, view)
        return cached.array

    def unit(self, volume: Any, derived: DerivedField) -> Any:
        """Return the unit: that of the argument, per length or per length squared."""
        if is_component(derived):
            return common_unit(volume, derived)[0]
        unit = volume.expression_unit(derived.arguments[0])
        if is_dex(unit):  # a logarithm changes by a plain number
            unit = None
        if unit is None and volume.unit is None:
            return None
        from astropy import units as u

        power = 2 if derived.operation == "laplacian" else 1
        length = u.dimensionless_unscaled if volume.unit is None else volume.unit
        return parse_unit((u.dimensionless_unscaled if unit is None else unit) / length**power)

    def forget(self, field: str) -> None:
        """Drop the cached derivatives of a field."""
        self._kept = {n: kept for n, kept in self._kept.items() if field not in kept.source}

    def refresh(self, volume: Any) -> None:
        """Drop cached derivatives of arrays that were changed in place.

        If memory is short, drop all. This is done here and not when the next one is computed,
        because the same expression may need several.
        """
        if self._kept and not fits(_SPARE * volume.grid.size):
            self._kept.clear()
        used = {name for kept in self._kept.values() for name in kept.source}
        now = {name: volume.digest(name) for name in used}
        for name in [n for n, kept in self._kept.items() if not kept.source.items() <= now.items()]:
            del self._kept[name]
