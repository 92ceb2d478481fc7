"""What a coarser level does to a picture: an estimate from how far cells are from their mean.

Within a cell of a level the fields are taken to be spread evenly between the least and the largest
value of the cells that it covers. From the medium at some of these values follows by how much its
coefficients differ from those of the mean. Where cells are drawn as they are (``"first-order"``)
the largest differences add up along a ray, because neighbours may all be off to the same side.
Where fields are interpolated the mean differences add up, and the squares of those beside them,
which have either sign.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.types import Mask
from ..deferred import Deferred, Pieces
from ..expressions.interval import Interval
from ..media.context import Context, MediumSample
from ..media.contract import Medium
from .pieces import pieces_of, widen_to_neighbours
from .prepare import prepare
from .run import run

if TYPE_CHECKING:
    from ..store import FieldStore
    from ..volume import Volume
    from .sweep import Sweep

# Values within a cell at which the medium is evaluated, from the least to the largest: shells that
# are much thinner than their distance are seen in some cells, not in all. Fewer, where at each of
# them values beside it are evaluated, too.
_VALUES, _FEWER = 17, 4
_ENDS = ("least of", "largest of", "beside")
# Part of the errors of either sign that is taken to be of one: of waves along the line of sight.
_ALIKE = 0.2
# Factor on an estimate from root mean squares: of each picture of the tests at least 97.5 % of the
# errors are within it, 96 % without.
_SURE = 1.5
# Beyond the last centres what is drawn does not vary: errors are of one sign, and count for more.
_OUTERMOST = 4.0
# Where, in parts of how far cells are beside what is interpolated.
_ASIDE = (-0.75, -0.25, 0.25, 0.75)
# Distances from means are stored with few digits.
_MORE = 0.01


class LevelError(Medium):
    """The error of the light of one cell and its surroundings, in parts of a brightness.

    Its channels are errors that add up along a ray and squares of errors of either sign; they are
    absorbed by no more than the least extinction.

    Parameters
    ----------
    medium : Medium
        What is drawn, in plain numbers.
    brightness : float
        That of the picture: more light than this is not lost or gained in a cell.
    width : float
        The longest way through a cell.
    interpolated : bool
        Whether fields are interpolated between cells.
    """

    channels, grey = 2, False

    def __init__(self, medium: Medium, brightness: float, width: float, interpolated: bool) -> None:
        self.medium, self.brightness, self.width = medium, brightness, width
        self.own, self.interpolated = medium.names, interpolated
        ends = _ENDS if interpolated else _ENDS[:2]
        self.names = (*self.own, *(f"{end} {name}" for end in ends for name in self.own))

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        """Return errors per unit length."""
        medium = self.medium

        def at(place: float, aside: float = 0.0) -> list[Any]:
            values = dict(fields)
            for name in self.own:
                low, high = (fields[f"{end} {name}"] for end in _ENDS[:2])
                values[name] = low + (high - low) * place
                if aside:
                    values[name] = values[name] + aside * fields[f"{_ENDS[2]} {name}"]
            return medium.coefficients(values, context).listed()

        usual = medium.coefficients(fields, context).listed()
        least, steady, either = list(usual), [0.0] * len(usual), [0.0] * len(usual)
        for k in range(_FEWER if self.interpolated else 0):
            place = (k + 0.5) / _FEWER
            drawn, others = at(place), [at(place, aside) for aside in _ASIDE]
            for i, value in enumerate(drawn):
                apart = [other[i] - value for other in others]
                least[i] = functools.reduce(dr.minimum, [other[i] for other in others], least[i])
                steady[i] = steady[i] + dr.abs(sum(apart)) / (len(apart) * _FEWER)
                either[i] = either[i] + sum(a * a for a in apart) / (len(apart) * _FEWER)
        for k in range(0 if self.interpolated else _VALUES):
            for i, value in enumerate(at(k / (_VALUES - 1))):
                least[i] = dr.minimum(least[i], value)
                steady[i] = dr.maximum(steady[i], dr.abs(value - usual[i]))
        bright, width = context.number(self.brightness), context.number(self.width)

        def relative(errors: list[Any]) -> Any:
            """Return the error of the light, per unit length: at most all of it in a cell."""
            light = functools.reduce(dr.maximum, errors[: medium.channels]) / bright
            dark = functools.reduce(dr.maximum, errors[medium.channels :])
            return dr.minimum(light + dark, 2.0 / width)  # the way may be half as long

        random = (
            relative([dr.sqrt(square) for square in either]) if self.interpolated else bright * 0.0
        )
        dark = dr.maximum(functools.reduce(dr.minimum, least[medium.channels :]), 0.0)
        emission = [relative(steady) + _ALIKE * random, random * random * width]
        return MediumSample(emission, [dark, 2.0 * dark])

    def visible_in(self, fields: dict[str, Interval], context: Context) -> Mask:
        """Return where the medium itself may be visible, for any values within the cells."""
        around = dict(fields)
        for name in self.own:
            low, high = (fields[f"{end} {name}"] for end in _ENDS[:2])
            aside = fields[f"{_ENDS[2]} {name}"].hi if self.interpolated else 0.0
            around[name] = Interval(low.lo - aside, high.hi + aside)
        return self.medium.visible_in(around, context)

    def key(self) -> Any:
        """Return what identifies the medium."""
        inner = self.medium.key()
        return inner and ("LevelError", inner, self.brightness, self.width, self.interpolated)

    def describe(self) -> dict[str, Any]:
        """Return the medium of which these are the errors."""
        return {"type": "level_error", "medium": self.medium.describe()}


def level_error(
    level: Volume,
    medium: Medium,
    camera: Any,
    brightness: float,
    *,
    reach: float,
    memory: Any = None,
    sweep: Sweep | None = None,
    **options: Any,
) -> np.ndarray | None:
    """Return an estimate of the error of a picture of a level, shape (ny, nx); None if unknown.

    Parameters
    ----------
    level, medium, camera
        What was drawn; the medium in plain numbers.
    brightness : float
        The largest intensity of the picture; if it is zero, that of a path length is taken.
    reach : float
        Where the outermost of the finest cells in a cell are, in halves of its width: 1/2 at level
        1, 3/4 at level 2; 0 if the scheme does not interpolate between cells.
    memory, sweep, **options
        Of the picture: ``samples, precision, device``.
    """
    brightness = brightness or max(part.strongest()[0] for part in medium.components())
    volume: Any = with_spread(level, medium, reach) if brightness > 0.0 else None
    if volume is None:
        return None
    width = float(np.linalg.norm([edges[1] - edges[0] for edges in level.grid.edges]))
    errors, pieces = LevelError(medium, brightness, width, reach > 0.0), None
    if memory is not None or sweep is not None:
        pieces = pieces_of(volume, errors, memory, sweep)
        volume = pieces.outline
    job, _ = prepare(
        volume, errors, camera, scheme="first-order", tolerance=None, pieces=pieces, **options
    )
    steady, squares = np.moveaxis(run(job, 0.0).emission, -1, 0)
    found = steady + np.sqrt(np.maximum(squares, 0.0))
    if reach:
        found *= _SURE
    return np.asarray(brightness * np.minimum(found, 1.0))


def with_spread(level: Volume, medium: Medium, reach: float) -> Volume | None:
    """Return a level with fields for the least and largest values in its cells.

    None if they are not known: the file does not tell, or the medium sees more than its fields.
    """
    names = medium.names
    parts = medium.components()
    if any(part.surface_only or part.sight or part.thermal for part in parts):
        return None
    if not all(name in level.fields for name in names):
        return None
    pieces = {name: level._fields.pieces(name) for name in names}
    if any(one is None or one.spread is None or one.extremes is None for one in pieces.values()):
        return None
    other, store, shape = level.with_arrays({}), level.store, level.grid.shape
    if any(np.isnan(_chunk_ends(store, name, 0)).any() for name in names):
        return None  # the cells that have no value are hidden
    for name in names:
        kind = level._fields.dtype(name)
        kind = kind if kind.kind == "f" else np.dtype(np.float32)
        for which, end in enumerate(_ENDS if reach else _ENDS[:2]):
            read = functools.partial(_end, store, name, which, reach)
            known = functools.partial(_chunk_ends, store, name, which)
            load = functools.partial(read, (0, 0, 0), shape, 0)
            what = Deferred(load, kind, pieces=Pieces(read, store.chunks, (), known))
            other._fields.defer(f"{end} {name}", what.load, what, shape)
            other._units[f"{end} {name}"] = level.field_unit(name)
    return other


def _chunk_ends(store: FieldStore, name: str, which: int) -> np.ndarray:
    """Return ranges of chunks with their neighbours': cells at a wall see those beyond."""
    found = store.extremes(name)
    assert found is not None
    table = found.astype(np.float64)
    more = _MORE * (table[..., 1] - table[..., 0])
    table[..., 0] -= more
    table[..., 1] += more
    widen_to_neighbours(table[..., 0], table[..., 1])
    if which == 2:
        table[..., 1] = _OUTERMOST * (table[..., 1] - table[..., 0])
        table[..., 0] = 0.0
    return table


def _end(
    store: FieldStore,
    name: str,
    which: int,
    reach: float,
    low: Sequence[int],
    high: Sequence[int],
    level: int,
) -> np.ndarray:
    """Return the least (0) or the largest (1) values in the cells of a box.

    Without a `reach`, of the finest cells. Else of the means interpolated between the centres of
    the level's cells, and how far (2) the finest cells are beyond these, or these beyond them.
    """
    distances = store.spread(name, low, high)
    assert distances is not None
    kind, ends = distances[0].dtype, zip(low, high, store.shape(0), strict=True)
    box = [(max(a - 1, 0), min(b + 1, n)) for a, b, n in ends]
    # Cells of the box that have neighbours on all sides.
    inner = [(f + 1 - a, e - 1 - a) for a, (f, e) in zip(low, box, strict=True)]
    first, last = zip(*box, strict=True)
    means = store.read(name, first, last).astype(kind, copy=False)
    beyond = zip(low, high, box, strict=True)
    around = np.pad(means, [(1 - (a - f), 1 - (e - b)) for a, b, (f, e) in beyond], "edge")

    def shifted(way: Sequence[int]) -> Any:
        counts = (b - a for a, b in zip(low, high, strict=True))
        return around[tuple(slice(1 + s, 1 + s + n) for s, n in zip(way, counts, strict=True))]

    own = shifted((0, 0, 0))
    cells = own - distances[0], own + distances[1]
    if not reach:
        return np.ascontiguousarray(cells[which])
    least, largest = own.copy(), own.copy()
    # The centres of the finest cells are not at the walls.
    least_there, largest_there = own.copy(), own.copy()
    for way in itertools.product((-1, 0, 1), repeat=3):
        if sum(map(abs, way)) == 2:  # between those of faces and of corners
            continue
        corners = list(itertools.product(*[(0, s) if s else (0,) for s in way]))
        place = sum(map(shifted, corners)) / kind.type(len(corners))
        np.minimum(least, place, out=least)
        np.maximum(largest, place, out=largest)
        there = own + kind.type(reach) * (place - own)
        np.minimum(least_there, there, out=least_there)
        np.maximum(largest_there, there, out=largest_there)
    beside = np.maximum(np.abs(cells[0] - least_there), np.abs(cells[1] - largest_there))
    outside = np.ones(beside.shape, bool)
    outside[tuple(slice(f, e) for f, e in inner)] = False
    beside[outside] *= _OUTERMOST
    return np.ascontiguousarray((least, largest, beside)[which])
