"""A medium evaluated on ranges of cells, and the coordinates of their centres."""

from __future__ import annotations

import copy
import functools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ...backend import Backend, dr, from_host
from ...backend.types import Float, Int, Mask
from ...derivatives.vectors import sight_cosines
from ...errors import InputError
from ...expressions import Expression
from ...expressions.interval import Interval
from ...fields import COORDINATES, coordinates
from ...geometry import CARTESIAN
from ...grids.cartesian.grid import CartesianGrid
from ...media.bound import Binding
from ...media.context import Context, Tape
from ...media.contract import Medium
from ...memory import check_memory
from ...ranges import device_array
from ...schemes.channels import Channels, channel_groups
from ...volume import Volume
from ..cache import VolumeStatistics
from ..precision import largest_coefficients, sizes_of_coefficients

# Dr.Jit arrays, and the offsets of packets in them, are 32-bit.
LARGEST = 2**32 - 1
# Cells classified at once: limits the memory of temporaries, and the delay of an interrupt.
SLAB = 1 << 19
# What is made of so few cells takes no time; a table names the first one with bad coefficients.
FEW_CELLS = 1 << 22
# Runs of consecutive cells in which sizes without bounds are looked up.
_RUNS, _RUN = 8, 1 << 13


class CellEvaluator:
    """Evaluates a medium on the cells of a volume.

    Attributes
    ----------
    channels : Channels
        Which values are computed per cell.
    places : list of str
        The coordinates that the medium uses. Those of Cartesian grids are computed in
        the kernel. Those of other grids are computed on the host: for consecutive cells during
        classification, for all cells during ray tracing.
    tape : Tape, optional
        Records the numbers of the medium.
    """

    def __init__(
        self,
        volume: Volume,
        medium: Medium,
        backend: Backend,
        statistics: VolumeStatistics | None = None,
        tape: Tape | None = None,
    ) -> None:
        binding = Binding.to(volume, volume.grid.scale, backend.precision)
        self.volume, self.medium, self.channels = volume, medium, Channels(medium, binding)
        self.backend, self.grid, self.tape = backend, volume.grid, tape
        self.statistics = statistics or VolumeStatistics(volume)
        check_fields(volume, medium)
        self.places = [n for n in medium.names if n in volume.coordinates and n not in volume]
        cartesian = all(name in COORDINATES for name in self.places)
        self._traced = cartesian and isinstance(self.grid, CartesianGrid)
        self.origin: tuple[int, ...] = ()

    def normalised(self) -> CellEvaluator:
        """Return the evaluator with the units of emission that suit kernels."""
        return self.using(self.channels.normalised(self.sizes))

    def using(self, channels: Channels) -> CellEvaluator:
        """Return the evaluator of some of the channels, or of other values per cell."""
        part = copy.copy(self)
        part.medium, part.channels = channels.medium, channels
        return part

    def within(self, volume: Volume, origin: tuple[int, int, int]) -> CellEvaluator:
        """Return the evaluator of a part of the volume that begins at a cell of it.

        Ranges remain those of the whole volume.
        """
        part = copy.copy(self)
        part.volume, part.grid, part.origin = volume, volume.grid, origin
        vars(part).pop("all_coordinates", None)
        return part

    def context(self, real: Any, tape: Tape | None = None) -> Context:
        """Return the context that evaluates the medium with a given number type."""
        opaque = dr.opaque if tape is None else tape.number
        return Context(
            real=real,
            number=functools.partial(opaque, real),
            opaque=opaque,
            tape=tape,
        )

    def evaluate(self, fields: dict[str, Float], real: Any = None) -> list[Float]:
        """Return the values of a table, per unit of the grid's scale (traced)."""
        context = self.context(real or self.backend.Wide, self.tape)
        return self.channels.table_values(fields, context)

    def classify(self, first: int, count: int) -> tuple[list[Float], Mask]:
        """Return the values of consecutive cells, and where they cannot be used (traced)."""
        backend = self.backend
        if self._traced:
            fields = self._centers(dr.arange(backend.UInt, count) + dr.opaque(backend.UInt, first))
        else:
            places = coordinates(self.grid, self.places, first, first + count)
            fields = {name: from_host(backend.Wide, values) for name, values in places.items()}
        for name in self.medium.names:
            if name not in fields:
                flat = self.volume.array(name).reshape(-1)[first : first + count]
                fields[name] = backend.Wide(device_array(flat, backend, whole_vectors=True))
        for axis in self.medium.sight:
            cosines = sight_cosines(self.volume, axis, first, first + count)
            fields[f"los.{axis}"] = from_host(backend.Wide, np.ascontiguousarray(cosines))
        spread = dr.zeros(backend.Wide, count)
        values = [spread + v for v in self.evaluate(fields)]
        bad = backend.Bool(False)
        for v in values:
            bad |= ~dr.isfinite(v)
        for v in values[self.channels.signed :]:
            bad |= v < 0
        return values, bad

    def refuse(self, values: list[Float], bad: Mask, first: int) -> None:
        """Raise the error that names the first cell with unusable coefficients."""
        bad = np.asarray(bad)
        place, channels = int(np.flatnonzero(bad)[0]), self.channels.emissions
        cell = tuple(int(i) for i in np.unravel_index(first + place, self.grid.shape))
        wrong = []
        for k, v in enumerate(values):
            value = float(np.asarray(v)[place]) / self.grid.scale
            if not np.isfinite(value) or (k >= channels and value < 0):
                name = "emissivity" if k < channels else "extinction"
                wrong.append(f"{name} of channel {k % channels} is {value:g}")
        names = [name for name in self.medium.names if name in self.volume]
        fields = ", ".join(f"{name} = {self.volume.array(name)[cell]:g}" for name in names)
        if self.origin:
            cell = tuple(a + i for a, i in zip(self.origin, cell, strict=True))
        raise InputError(
            f"the medium gives coefficients that cannot be used in {int(bad.sum())} cells (of "
            f"those looked at so far); the first is {cell}: {'; '.join(wrong)}"
            f"{f', where {fields}' if fields else ''}. Emissivity must be finite, extinction "
            "finite and not negative: clip the fields, or use where(...) in the expression"
        )

    def coordinates(self, cell: Int, active: Mask) -> dict[str, Float]:
        if self._traced:
            return self._centers(cell)
        Wide, whole = self.backend.Wide, self.all_coordinates
        return {name: dr.gather(Wide, data, cell, active) for name, data in whole.items()}

    def _centers(self, cell: Int) -> dict[str, Float]:
        UInt, Wide = self.backend.UInt, self.backend.Wide
        ny, nz = (dr.opaque(UInt, n) for n in self.grid.shape[1:])
        row = self.backend.quotient(cell, nz)
        i = self.backend.quotient(row, ny)
        index = (i, row - i * ny, cell - row * nz)
        centers = [from_host(Wide, c) for c in self.grid.centers]
        found = (dr.gather(Wide, c, k) for c, k in zip(centers, index, strict=True))
        values = dict(zip("xyz", found, strict=True))
        values["r"] = dr.sqrt(sum(values[name] * values[name] for name in "xyz"))
        return {name: values[name] for name in self.places}

    @functools.cached_property
    def all_coordinates(self) -> dict[str, Float]:
        """The coordinates of all cells, if kernels do not compute them."""
        if self._traced or not self.places:
            return {}
        size, Wide = self.grid.size, self.backend.Wide
        advice = "leave coordinates out of the medium, or coarsen the volume"
        check_memory(8 * size * len(self.places), "coordinates of all cells", advice)
        whole = {name: np.empty(size) for name in self.places}
        for first in range(0, size, SLAB):
            last = min(first + SLAB, size)
            for name, values in coordinates(self.grid, self.places, first, last).items():
                whole[name][first:last] = values
        return {name: from_host(Wide, values) for name, values in whole.items()}

    @functools.cached_property
    def largest(self) -> list[float]:
        """See `precision.largest_coefficients`."""
        return largest_coefficients(self.statistics, self.channels)

    @functools.cached_property
    def sizes(self) -> list[float]:
        """The bounds, or for a spectrum without them the largest values in some cells."""
        channels, sizes = self.channels, list(self.largest)
        if not channels.spectral or np.all(np.isfinite(sizes[: channels.emissions])):
            return sizes
        count = min(_RUN, self.grid.size)
        for group in channel_groups(self.medium):
            part = self.using(channels.group(group))
            part.tape = None
            for first in np.linspace(0, self.grid.size - count, _RUNS).astype(int).tolist():
                values, _ = part.classify(first, count)
                dr.eval(values)
                for c, found in zip(range(group.start, group.stop), values, strict=False):
                    size = np.abs(np.asarray(found))
                    most = float(size[np.isfinite(size)].max(initial=0.0))
                    sizes[c] = most if sizes[c] == np.inf else max(most, sizes[c])
        return sizes

    def most_in(self, fields: dict[str, Interval]) -> list[np.ndarray]:
        """Return bounds of |j| and α per unit of the grid's scale, with fields in ranges."""
        return sizes_of_coefficients(self.channels.bound, fields)


def check_fields(volume: Volume, medium: Medium) -> None:
    """Raise the error that names the nearest field if a medium uses an unknown one."""
    for name in medium.names:
        if name not in volume.coordinates and name not in volume:
            volume.array(name)


_ACROSS = "sqrt(x*x + y*y)"


def ray_coordinates(volume: Volume, names: Iterable[str]) -> dict[str, Expression]:
    """Return the named curvilinear coordinates of the grid, as expressions of x, y and z."""
    grid = volume.grid
    own = [n for n in names if n in grid.coordinates and n not in (*COORDINATES, *volume)]
    return {name: _formula(name, grid) for name in own}


def _formula(name: str, grid: Any) -> Expression:
    if name == "R":
        return Expression(_ACROSS)
    if name == "theta":
        height = "abs(z)" if grid.mirror else "z"
        return Expression(f"atan2({_ACROSS}, {height})")
    # Azimuths that exceed the first one by less than a full circle.
    first = float(grid.edges[grid.coordinates.index("phi")][0])
    return Expression(f"atan2(y, x) - 2*pi*((atan2(y, x) - {first!r}) // (2*pi))")


def along_sight(
    axes: Iterable[str], ahead: Sequence[Float], place: Sequence[Float], mirror: bool
) -> dict[str, Float]:
    """Return the cosines between axes and the line of sight at places in the volume's coordinates.

    A vector below the midplane of a `mirror` is the mirror image of that above it.

    Parameters
    ----------
    axes : iterable of str
        Such as ``"x"``, or ``"r"``, ``"theta"``, ``"phi"``.
    ahead : three arrays
        Unit vector away from the observer.
    place : three arrays
        Needed only for axes that turn from place to place.
    """
    found = {axis: ahead["xyz".index(axis)] for axis in axes if axis in CARTESIAN}
    if len(found) < len(axes := list(axes)):
        x, y, z = place
        across = dr.sqrt(x * x + y * y)
        per_across = _inverse(across)
        cos, sin = dr.select(across > 0.0, x * per_across, 1.0), y * per_across
        radial = ahead[0] * cos + ahead[1] * sin
        per_r = _inverse(dr.sqrt(across * across + z * z))
        up, out = z * per_r, across * per_r
        turned = {
            "R": radial,
            "phi": ahead[1] * cos - ahead[0] * sin,
            "r": radial * out + ahead[2] * up,
            "theta": radial * up - ahead[2] * out,
        }
        found |= {axis: turned[axis] for axis in axes if axis not in CARTESIAN}
    for axis in ("z", "theta"):
        if mirror and axis in found:
            found[axis] = dr.select(place[2] < 0.0, -found[axis], found[axis])
    return {f"los.{axis}": value for axis, value in found.items()}


def _inverse(length: Float) -> Float:
    return dr.select(length > 0.0, 1.0 / dr.select(length > 0.0, length, 1.0), 0.0)
