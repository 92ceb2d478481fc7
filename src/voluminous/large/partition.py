"""How a volume is drawn and measured: as one block in memory, or block by block from its file."""

from __future__ import annotations

from typing import Any

from ..errors import InputError
from ..grids.cartesian.grid import CartesianGrid
from ..grids.contract import Grid
from ..grids.structured import is_structured
from ..grids.trees.cells import TreeCells
from ..media.contract import Medium
from ..rendering.partition import Partition
from .chunks import CartesianChunks
from .sweep import Sweep
from .trees import TreeParts
from .view import VolumeView


def partition_of(volume: Any, memory: Any, medium: Any = None) -> Partition:
    """Return the partition of a volume, to draw a medium if one is given; in memory one block."""
    if memory is not None and medium is not None:
        check_drawn(volume, medium)
    return Partition(volume) if memory is None else chunks_of(volume, memory)


def chunks_of(volume: Any, memory: Any, sweep: Sweep | None = None) -> CartesianChunks:
    """Return the blocks of chunks of a volume's file."""
    check_grid(volume.grid)
    kind = CartesianChunks if is_structured(volume.grid) else TreeParts
    return kind(volume, memory, sweep)


def drawn_in_blocks(
    volume: Any,
    medium: Any,
    memory: Any,
    executor: Any = None,
    checkpoint: Any = None,
    bounds: Any = False,
) -> CartesianChunks:
    """Return the blocks of chunks of which a picture is drawn, here or by an executor."""
    check_drawn(volume, medium, bounds)
    if executor is None and checkpoint is None:
        return chunks_of(volume, memory)
    needed = VolumeView.of(volume).stored(medium.names)
    return chunks_of(_lean(volume, needed), memory, Sweep(executor, checkpoint))


def check_grid(grid: Grid) -> None:
    """Refuse grids that are not read chunk by chunk."""
    if not isinstance(grid, (CartesianGrid, TreeCells)):
        raise InputError(
            "memory= reads Cartesian grids chunk by chunk, octrees and patches part by part; this "
            f"is a {type(grid).__name__}: leave out memory=, or "
            "volume.resample(vm.CartesianGrid.uniform(…))"
        )


def check_drawn(volume: Any, medium: Any, bounds: Any = False) -> None:
    """Refuse what cannot be drawn chunk by chunk."""
    grid = getattr(volume, "grid", None)
    if grid is None or not isinstance(medium, Medium):
        raise InputError(
            "memory= draws a vm.Volume with a medium that is given, as in vm.render(volume, "
            f"medium, camera, memory='2 GiB'); got {type(volume).__name__} and "
            f"{type(medium).__name__}"
        )
    check_grid(grid)
    if bounds:
        raise InputError(
            "bounds=True looks at the fields as a whole: leave it out, or draw without memory="
        )


def _lean(volume: Any, names: Any) -> Any:
    """Return a volume without other fields in memory: other processes read what is in files."""
    lean = volume.unread()
    for name in lean.fields:
        if name not in names and name not in lean.waiting:
            del lean[name]
    lean.tables = volume.tables
    return lean
