"""A volume as blocks of cells, which rays come to one after another; in memory it is one block."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..grids.cartesian.walk import BRICK
from ..grids.contract import CellBox, cells_across
from ..packages import REGISTERED
from ..ranges import CELLS, DUAL, Ranges, box_side, ranges_of_field
from ..volume import Volume
from .cache import Cache
from .job import RayJob, RenderJob
from .missing import Completed, complete
from .sources.cells import CellEvaluator
from .sources.interpolated import interpolated_fields
from .sources.table import tabulated
from .tracer import KernelCache, RayTracer

if TYPE_CHECKING:
    from ..cameras.contract import Camera
    from ..media.contract import Medium
    from ..schemes.base import Scheme

# Cells evaluated at once.
_CHUNK = 1 << 20


class Partition:
    """The blocks of cells of a volume: of this one, in memory, there is one block.

    Attributes
    ----------
    volume : Volume
        All of it, as a camera sees it; if larger than memory names, units, ranges and samples.
    """

    volume: Volume
    labels = "second-order"  # default scheme of numbers that must not be interpolated

    def __init__(self, volume: Volume) -> None:
        self.volume = volume

    def seen_by(self, camera: Camera | None, medium: Medium, scheme: Scheme) -> Volume:
        """Return the volume that a camera sees; refuse schemes that cannot draw its blocks."""
        self.volume = self.volume.seen_by(camera)
        return self.volume

    def complete(self, cache: Cache, names: Iterable[str], by_field: bool) -> Completed:
        """Return the volume with missing values filled, or hidden; see `missing.complete`."""
        return complete(cache, names, by_field)

    def plan(self, medium: Medium, scheme: Scheme, pixels: tuple[int, int]) -> None:
        """Set the blocks that a picture is drawn of."""

    def source(self, job: RayJob, evaluator: CellEvaluator, faintest: bool) -> Any:
        """Return the coefficients for the scheme."""
        scheme, whole = job.scheme, job.hidden is None
        steps = job.rays * cells_across(job.volume.grid)
        if scheme.coefficients_at == "field":
            limits = job.tolerance, faintest, whole, steps
            return interpolated_fields(evaluator, job.cache, scheme, *limits)
        return tabulated(evaluator, job.cache, scheme, steps, whole)

    def tracer(self, job: RenderJob, source: Any, background: float, faintest: bool) -> RayTracer:
        """Return what traces rays through all blocks."""
        kind = REGISTERED["tracer"]["radmc3d"]() if job.recursive else RayTracer
        tracer: RayTracer = kind(job, source, background)
        if job.backend.device == "cpu" and job.tape is None:
            ending = tracer.ending
            key = job.key(
                "kernels",
                job.camera.key(),
                (faintest, job.hidden is None, job.clip and job.clip.form),
                (type(source), type(tracer.walk), None if ending is None else len(ending.weights)),
            )
            tracer.kernels = job.cache.get_or_make(key, KernelCache)
        return tracer

    @functools.cached_property
    def ranged(self) -> Sequence[int]:
        """Sides of the boxes of cells of which `ranges_around` gives the ranges."""
        return (box_side(self.volume.grid.shape),) * 3

    def ranges_around(self, cache: Cache, names: Iterable[str]) -> Ranges:
        """Return the ranges of fields in each box of cells and those beside it, flat."""
        shape, side = cache.volume.grid.shape, self.ranged[0]
        window = CELLS if side == BRICK else DUAL  # of large volumes those of rays' bricks
        return {n: ranges_of_field(cache, n, window).in_boxes(side, shape) for n in names}

    def blocks_of(self, names: Iterable[str], per_cell: int, others: int) -> Iterator[CellBox]:
        """Yield the blocks in which fields are measured, given bytes needed besides them."""
        shape = self.volume.grid.shape
        yield CellBox((0,) * len(shape), shape)

    def part(self, box: CellBox, names: Iterable[str]) -> Volume:
        """Return such a block as a volume with some fields."""
        return self.volume

    def with_field(self, name: str, expression: Expression) -> tuple[Volume, bool]:
        """Return a volume with an expression as a field, and whether it lacks values."""
        grid, values = self.volume.grid, np.empty(self.volume.grid.size)
        for first in range(0, grid.size, _CHUNK):
            last = min(first + _CHUNK, grid.size)
            own = self.volume.evaluate_cells(expression, first, last, double=True)
            check_finite(self.volume, own, expression, first)
            values[first:last] = own
        lacks = np.isnan(values)
        if lacks.all():
            raise InputError(f"{expression.text!r} has no value in any cell")
        other = self.volume.with_arrays({name: np.reshape(values, grid.shape)})
        other.set_unit(name, None)
        return other, bool(lacks.any())

    def extremes_of(self, expression: Expression) -> np.ndarray:
        """Return values of an expression among which are its least and largest finite ones."""
        return np.asarray(self.volume.evaluate(expression), dtype=np.float64)

    def alone(self) -> Partition:
        """Return the same blocks, drawn in this process."""
        return self

    def finish(self) -> None:
        """End a picture: of what draws it elsewhere nothing is left."""


def check_finite(
    volume: Volume,
    values: np.ndarray,
    expression: Expression,
    first: int,
    low: tuple[int, ...] = (0, 0, 0),
) -> None:
    """Refuse a quantity that is infinite in one of consecutive cells; `low` is a block's first."""
    infinite = np.flatnonzero(np.isinf(values))
    if infinite.size:
        place = np.unravel_index(first + int(infinite[0]), volume.grid.shape)
        if len(place) == len(low):
            place = tuple(a + i for a, i in zip(low, place, strict=True))
        raise InputError(
            f"{expression.text!r} is infinite in cells, the first of which is "
            f"{tuple(int(i) for i in place)}: leave them out, where(…, …, 0), or have them missing "
            "(NaN)"
        )
