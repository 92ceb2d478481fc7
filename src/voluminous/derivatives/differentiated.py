"""Which differences a grid takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..geometry import CARTESIAN
from .curvilinear import Curvilinear
from .differences import differentiate
from .layers import in_single, whole
from .neighbours import Cells
from .on_trees import BoxesOfTree, is_tree


def differentiated(volume: Any, operation: str, argument: Expression) -> np.ndarray:
    """Return a derivative of an expression in all cells, in units of the grid's length.

    Parameters
    ----------
    volume : Volume
        On any grid: parabolas along its axes where it has three, else differences of neighbours.
    operation : str
        ``gradmag``, ``laplacian``, ``grad.x``, ``grad.y`` or ``grad.z``: Cartesian components on
        all grids.
    argument : Expression
        What is differentiated.

    Returns
    -------
    array
        Of the grid's shape; float32 if the argument is, and its range allows.
    """
    if not volume.grid.cells_are_boxes:
        raise InputError(
            f"{operation} needs cells that are boxes, got a {type(volume.grid).__name__}; resample "
            "the volume first: volume.resample(vm.CartesianGrid.uniform(...))"
        )
    if volume.grid.is_structured:
        return _along_axes(volume, operation, argument)

    def cells(first: int, last: int) -> np.ndarray:
        return np.asarray(volume.evaluate_cells(argument, first, last))

    found = differences(volume.grid, cells).derivative(operation).reshape(volume.grid.shape)
    single = cells(0, 1).dtype == np.float32 and in_single(found)
    return found.astype(np.float32) if single else found


def differences(grid: Any, evaluate: Callable[[int, int], np.ndarray]) -> Cells | BoxesOfTree:
    """Return what compares the neighbours of any grid: in kernels, where these find them.

    Parameters
    ----------
    grid : grid
        See `grids.contract.Grid`.
    evaluate : callable
        Returns what is differentiated, for the cells between two numbers.
    """
    return (BoxesOfTree if is_tree(grid) else Cells)(grid, evaluate)


def _along_axes(volume: Any, operation: str, argument: Expression) -> np.ndarray:
    grid = volume.grid
    _, n2, n3 = grid.shape

    def layers(part: slice) -> np.ndarray:
        values = volume.evaluate_cells(argument, part.start * n2 * n3, part.stop * n2 * n3)
        return np.asarray(values.reshape(-1, n2, n3))

    system = tuple(grid.coordinates)
    if system == CARTESIAN:
        return whole(operation, layers, grid.centers, differentiate)
    centers = [0.5 * (edges[1:] + edges[:-1]) for edges in grid.edges]
    return whole(operation, layers, centers, Curvilinear(system, grid.edges, grid.mirror))
