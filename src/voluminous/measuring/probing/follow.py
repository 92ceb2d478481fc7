"""Record fields, coefficients and intensity in each segment of one ray."""

from __future__ import annotations

import copy
import numbers
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr
from ...errors import InputError
from ...expressions import Expression, NumpyOps
from ...grids.two_walks import cell_of
from ...media.ranges import RangeContext
from ...rendering.job import RenderJob
from ...rendering.run import run
from ...rendering.sources.channel_layout import before
from ...rendering.tracer import Batches, Paths, RayTracer
from ...schemes.base import Position, Scheme, interpolated_at
from ...schemes.path import Path
from ...units import parse_unit, plain, unit_name
from ..quantity import CellQuantity
from .result import Probe

if TYPE_CHECKING:
    from ...backend import Backend
    from ...backend.types import Float, Mask
    from ...cameras import Frame
    from ...grids.contract import Grid, Segment
    from ...media import Medium
    from ...volume import Volume

# The two halves of a segment; its coefficients are the mean of theirs.
_HALVES = ((0.0, 0.5), (0.5, 1.0))


class Tape:
    """Rows of numbers that a kernel writes, one after another."""

    def __init__(self, backend: Backend, capacity: int) -> None:
        self.backend, self.capacity = backend, capacity
        self.columns: dict[str, list[Any]] = {}
        self.limit = dr.opaque(backend.UInt, capacity)

    def prepare(self, columns: dict[str, int]) -> None:
        """Allocate columns; ``columns`` maps each name to its number of values per row."""
        for name, count in columns.items():
            kind = self.backend.UInt if name == "cell" else self.backend.Wide
            self.columns[name] = [dr.zeros(kind, self.capacity) for _ in range(count)]
        dr.eval(self.columns)

    def write(self, row: Any, active: Any, values: dict[str, list[Any]]) -> None:
        """Write a row (traced)."""
        there = active & (row < self.limit)
        for name, row_values in values.items():
            for column, number in zip(self.columns[name], row_values, strict=True):
                dr.scatter(column, type(column)(number), row, there)

    def read(self, count: int) -> dict[str, np.ndarray]:
        """Return the first ``count`` rows: for each name an array of shape (count, numbers)."""
        return {
            name: np.array([np.asarray(c)[:count] for c in columns]).reshape(len(columns), count).T
            for name, columns in self.columns.items()
        }


class SegmentRecorder(Scheme):
    """Wrap a scheme and write the solution of each segment to a tape.

    The carried state is the number of segments so far, the coefficients at the end of the last
    segment (only for schemes with coefficients at vertices), and the wrapped scheme's state.
    """

    def __init__(self, scheme: Scheme, tape: Tape, names: tuple[str, ...]) -> None:
        self.scheme, self.tape, self.names = scheme, tape, names
        self.name, self.coefficients_at = scheme.name, scheme.coefficients_at
        self.controlled = scheme.controlled
        self.own = 1

    def start(self, position: Position, source: Any) -> list[Any]:
        """Return the initial state, with a segment count of zero; allocate the tape."""
        numbers = source.numbers
        columns = {"begin": 1, "end": 1, "cell": 1, "j": numbers.emissions}
        columns |= dict.fromkeys(("alpha", "transparency", "tau"), numbers.extinctions)
        columns["emission"] = numbers.emissions
        self.tape.prepare(columns | {f"field {name}": 1 for name in self.names})
        carried = [source.backend.UInt(0)]
        if self.coefficients_at == "vertex":
            corners = position.walk.entry_corners(position.track, position.cursor)
            carried += source.interpolate(corners, position.cursor.inside)
        self.own = len(carried)
        return [*carried, *self.scheme.start(position, source)]

    def after_skip(
        self, position: Position, source: Any, carried: list[Float], moved: Mask
    ) -> list[Any]:
        """Interpolate the vertex coefficients again and forward to the wrapped scheme."""
        (row, *before), inner = carried[: self.own], carried[self.own :]
        if before:
            before = interpolated_at(position, source, before, moved)
        inner = self.scheme.after_skip(position, source, inner, moved)
        return [row, *before, *inner]

    def after_hidden(self, carried: list[Float], onward: list[Float]) -> list[Any]:
        """Forward to the wrapped scheme; hidden segments are recorded, too."""
        inner = self.scheme.after_hidden(carried[self.own :], onward[self.own :])
        return [*onward[: self.own], *inner]

    def solve(
        self, segment: Segment, source: Any, carried: list[Float]
    ) -> tuple[Path, list[Float]]:
        """Return the segment's solution and the new carried state; record the segment."""
        row, *before = carried[: self.own]
        inner = carried[self.own :]
        found, inner = self.scheme.solve(segment, source, inner)
        (j, alpha), fields, after = self._seen(source, segment, before)
        begin, end = (_distance(source, segment, t) for t in (segment.begin, segment.end))
        cell = cell_of(segment)  # wide steps are through many
        values = {"begin": [begin], "end": [end], "cell": [row if cell is None else cell]}
        values |= {"j": j, "alpha": alpha, "tau": found.depth}
        values |= {"emission": found.emission, "transparency": found.transparency}
        values |= {f"field {name}": [fields[name]] for name in self.names}
        told = segment.active & (segment.length > 0.0)  # walls in one place
        self.tape.write(row, told, values)
        return found, [row + dr.select(told, source.backend.UInt(1), 0), *after, *inner]

    def _seen(
        self, source: Any, segment: Segment, before: list[Any]
    ) -> tuple[Any, dict[str, Any], list[Any]]:
        """Return mean coefficients, fields at the midpoint, and coefficients at the end."""
        if self.coefficients_at == "cell":
            return source.at(segment), {}, []
        if self.coefficients_at == "vertex":
            corners = segment.walk.exit_corners(segment.track, segment)
            after = list(source.interpolate(corners, segment.active))
            mean = [0.5 * (a + b) for a, b in zip(before, after, strict=True)]
            return source.numbers.split(mean), {}, after
        cubics = source.along(segment).polynomials()
        stretch = (source.stretch if self.scheme.controlled else source.straight)(
            cubics, segment.length
        )
        halves = [source.means(stretch.panel(*half)) for half in _HALVES]
        means = [
            [0.5 * (a + b) for a, b in zip(*parts, strict=True)]
            for parts in zip(*halves, strict=True)
        ]
        return means, stretch.fields(0.5), []


def _distance(source: Any, segment: Segment, t: Any) -> Any:
    """Return the distance of a point of a ray from the ray's origin, in the volume's unit."""
    Wide = source.backend.Wide
    return (Wide(segment.track.entry) + Wide(t)) * Wide(segment.walk.scale)


# Tape capacity, in multiples of the cells that a straight line through the middle crosses.
_ROOM = 2


class Watched(RayTracer):
    """Ray tracer that remembers the tolerance with which one pixel was drawn last."""

    watched: int
    allowed: Any = ()

    def batches(
        self, seconds: float | None = None, focus: tuple[float, float] | None = None
    ) -> Batches[Paths]:
        self.allowed = self.source.tolerance
        return super().batches(seconds, focus)

    def pixels(self, pixel: np.ndarray) -> Paths:
        if self.watched in pixel:
            self.allowed = self.source.tolerance
        return super().pixels(pixel)


def _source_of(job: RenderJob, pixel: int, brightest_background: float) -> Any:
    """Return the source with which a pixel is finally drawn.

    With error control, the tolerance depends on the whole picture, so the picture is drawn.
    """
    if not job.scheme.controlled:
        return _everywhere(job.source())

    def watched(*scene: Any) -> Watched:
        tracer = Watched(*scene)
        tracer.watched = pixel
        return tracer

    tracer: Any = run(job, brightest_background, watched).tracer
    source = _everywhere(tracer.source)
    source.tolerance = tracer.allowed
    return source


def _everywhere(source: Any) -> Any:
    """Return a copy of the source whose rays also visit empty cells if steps are single cells."""
    source = copy.copy(source)
    if source.blocks is None or not getattr(source.blocks, "coarse", False):
        source.blocks = source.walk = None
    return source


@dataclass(frozen=True)
class Followed:
    """A ray and its recorded segments, ordered from the observer on.

    Attributes
    ----------
    origin, direction : float64 array, shape (3,)
        Origin and direction of the ray, which points away from the observer.
    rows : dict of str to array, shape (segment, numbers)
    path : Path
        Result of the march itself, as numbers.
    stopped : bool
        True if the march stopped early.
    """

    origin: np.ndarray
    direction: np.ndarray
    rows: dict[str, np.ndarray]
    path: Path
    stopped: bool
    numbers: Any


class _Recording(RayTracer):
    """Ray tracer that records one ray."""

    def follow(self, place: Any, names: tuple[str, ...], capacity: int) -> Followed:
        scheme, tape = self.scheme, Tape(self.backend, capacity)
        self.scheme = SegmentRecorder(scheme, tape, names)
        ray = self.ray_through(*(np.array([part]) for part in place))
        state = self.march(ray)
        dr.eval(state, tape.columns)
        self.scheme = scheme
        count = int(state.carried[0][0])
        if count > capacity:
            return self.follow(place, names, count)
        rows = _outwards(tape.read(count)) if self.job.backward else tape.read(count)
        parts = (state.path.emission, state.path.transparency, state.path.depth)
        path = Path(*([np.asarray(v)[0] for v in part] for part in parts))
        origin, direction = (_vector(v) for v in (ray.origin, ray.direction))
        direction = -direction if self.job.backward else direction
        stopped = bool(np.asarray(state.cursor.inside)[0])
        return Followed(origin, direction, rows, path, stopped, self.source.numbers)


def follow(
    job: RenderJob, place: tuple[int, float, float], names: tuple[str, ...], brightest: float
) -> Followed:
    """Follow one ray and return all its segments."""
    tracer = _Recording(job, _source_of(job, place[0], brightest), brightest)
    room = _ROOM * int(job.volume.grid.cells_across) + 64
    return tracer.follow(place, names, room)


def _outwards(rows: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    turned = {name: values[::-1] for name, values in rows.items()}
    return {**turned, "begin": -turned["end"], "end": -turned["begin"]}


def _vector(parts: Any) -> np.ndarray:
    return np.array([float(np.asarray(part).reshape(-1)[0]) for part in parts])


@dataclass(frozen=True)
class PixelPlace:
    """A point of the image plane and the pixel that contains it, or the nearest one.

    Attributes
    ----------
    pixel : (int, int)
        ix, iy.
    offset : (float, float)
        Offset from the pixel's centre, in pixels.
    at : (float, float)
        Image-plane coordinates.
    """

    pixel: tuple[int, int]
    offset: tuple[float, float]
    at: tuple[float, float]

    @classmethod
    def of(cls, pixel: Any, at: Any, frame: Frame, unit: Any) -> PixelPlace:
        """Return the place given by exactly one of ``pixel`` and ``at``."""
        if (pixel is None) == (at is None):
            raise InputError("say which ray: pixel=(ix, iy), or at=(u, v) on the image plane")
        if pixel is not None:
            ix, iy = _checked(pixel, frame.pixels)
            u, v = (float(c[i]) for c, i in zip(frame.coordinates(), (ix, iy), strict=True))
            return cls((ix, iy), (0.0, 0.0), (u, v))
        u, v = _point(at, unit)
        steps = zip((u, v), frame.shift, frame.pixel, frame.pixels, strict=True)
        x, y = ((c - shift) / step + 0.5 * (n - 1) for c, shift, step, n in steps)
        ix, iy = (
            int(np.clip(np.floor(c + 0.5), 0, n - 1))
            for c, n in zip((x, y), frame.pixels, strict=True)
        )
        return cls((ix, iy), (x - ix, y - iy), (u, v))


def _checked(pixel: Any, pixels: tuple[int, int]) -> tuple[int, int]:
    listed = isinstance(pixel, (list, tuple)) or np.ndim(pixel) == 1
    pair = tuple(pixel) if listed and len(pixel) == 2 else ()
    whole = all(isinstance(i, numbers.Integral) for i in pair)
    if not pair or not whole or not all(0 <= i < n for i, n in zip(pair, pixels, strict=True)):
        raise InputError(
            "pixel must be two whole numbers (ix, iy), counted from 0 at the lower left corner of "
            f"the image of {pixels[0]} x {pixels[1]} pixels, got {pixel!r}"
        )
    return int(pair[0]), int(pair[1])


def _point(at: Any, unit: Any) -> tuple[float, float]:
    point = np.asarray(plain(at, unit, "at"))
    if point.shape != (2,) or not np.all(np.isfinite(point)):
        raise InputError(f"at must be two finite numbers (u, v) on the image plane, got {at!r}")
    return float(point[0]), float(point[1])


def looked_at(medium: Medium) -> tuple[list[Expression], list[Expression]]:
    """Return a medium's fields, and its expressions that are not just a field."""
    fields = [Expression(name) for name in medium.names]
    known = [feature.expr for feature in medium.known_features()]
    texts = {expr.text for expr in fields}
    more = {e.text: e for e in known if e.text not in texts and e.names}
    return fields, list(more.values())


def in_cells(volume: Volume, expr: Expression, cells: np.ndarray) -> np.ndarray:
    """Return an expression's values in cells; NaN for negative cell numbers."""
    known = {c: volume.evaluate_cells(expr, c, c + 1)[0] for c in np.unique(cells) if c >= 0}
    return np.array([known.get(c, np.nan) for c in cells], dtype=np.float64)


def on_the_ray(expr: Expression, recorded: dict[str, np.ndarray]) -> np.ndarray:
    """Evaluate an expression of the fields recorded along the ray."""
    with np.errstate(all="ignore"):
        values = expr.evaluate(NumpyOps(), {name: recorded[name] for name in expr.names})
    count = len(next(iter(recorded.values())))
    return np.broadcast_to(np.asarray(values, dtype=np.float64), (count,))


def wanted(volume: Volume, expressions: Any) -> list[Expression]:
    """Return the additional expressions that the user requested."""
    several = isinstance(expressions, (list, tuple))
    listed = list(expressions) if several else [expressions]
    quantities = [CellQuantity.of(volume, expr, "also") for expr in listed]
    return [Expression.of_tree(q.expression.tree, q.expression.names, q.text) for q in quantities]


def units_of(volume: Volume, expressions: list[Expression]) -> dict[str, str]:
    """Return the names of the expressions' units."""
    return {e.text: unit_name(volume.expression_unit(e)) for e in expressions}


def assembled(
    job: RenderJob,
    volume: Volume,
    place: PixelPlace,
    found: Followed,
    more: Any,
    background: np.ndarray,
) -> Probe:
    """Return a probe.

    Parameters
    ----------
    volume : Volume
        As the camera sees it, with all that is missing.
    found : Followed
        What was recorded, from the observer on.
    more : list of Expression
        What else is asked for.
    background : array, shape (channel,)
    """
    rows, grid = found.rows, volume.grid
    begin, end = rows["begin"][:, 0], rows["end"][:, 0]
    position = found.origin + 0.5 * (begin + end)[:, None] * found.direction
    cell = _cells(job, position, rows)
    hidden = _hidden(job, cell)
    fields, scalars, units = _values(job, volume, rows, cell, hidden, more)
    light = job.medium.intensity_unit(RangeContext(volume.unit, volume.expression_unit))
    units |= {"length": unit_name(volume.unit), "intensity": unit_name(parse_unit(light))}
    per_length = 1.0 / grid.scale
    b, theta = _mixed(found, "emission"), rows["transparency"]
    gathered, arriving = folded(b, theta, background.astype(np.float64))
    return Probe(
        begin=begin,
        end=end,
        position=position,
        cell=cell,
        index=_index(grid, cell),
        level=np.where(cell >= 0, grid.levels.reshape(-1)[cell], 0),
        hidden=hidden,
        fields=fields,
        scalars=scalars,
        j=_mixed(found, "j") * per_length,
        alpha=rows["alpha"] * per_length,
        tau=rows["tau"],
        theta=theta,
        b=b,
        depth=np.cumsum(rows["tau"], axis=0),
        gathered=gathered,
        arriving=arriving,
        background=np.array(background, dtype=np.float64),
        **_ending(found, background),
        stopped=found.stopped,
        pixel=place.pixel,
        at=place.at,
        axes=tuple(grid.coordinates),
        units=units,
        provenance={**job.provenance(), "camera": job.camera.describe()},
    )


def folded(
    b: np.ndarray, theta: np.ndarray, background: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what segments add up to from the front on, and from the back.

    Pairs (b, θ) compose: (b₁ + θ₁ b₂, θ₁ θ₂).

    Parameters
    ----------
    b : array, shape (n, c)
    theta : array, shape (n, 1) or (n, c)
    background : array, shape (c,)

    Returns
    -------
    gathered : array, shape (n, c)
        Seen by the observer of the first, the first two, … segments.
    arriving : array, shape (n, c)
        In front of each segment, of all behind, and of the background.
    """
    before = np.cumprod(np.vstack([np.ones_like(theta[:1]), theta[:-1]]), axis=0)
    gathered = np.cumsum(before * b, axis=0)
    arriving, light = np.empty_like(b), background
    for k in reversed(range(len(b))):
        light = b[k] + theta[k] * light
        arriving[k] = light
    return gathered, arriving


def _mixed(found: Followed, what: str) -> np.ndarray:
    """Return emissions in channels: in kernels they may be those of a medium's parts."""
    return np.asarray(found.numbers.mix(list(found.rows[what].T)), dtype=np.float64)


def _ending(found: Followed, background: np.ndarray) -> dict[str, np.ndarray]:
    emission = found.numbers.mix([np.asarray(v) for v in found.path.emission])
    through = np.stack(found.path.transparency)
    total = before(background, emission, through)
    depth = np.stack(found.path.depth)
    return {"intensity": total, "transparency": through, "optical_depth": depth}


def _cells(job: RenderJob, position: np.ndarray, rows: dict[str, np.ndarray]) -> np.ndarray:
    """Return the grid's own cells: schemes on interpolated fields walk between their centres."""
    if job.scheme.coefficients_at == "field" and job.hidden is None:
        return np.asarray(job.volume.grid.locate(position), dtype=np.int64)
    return rows["cell"][:, 0].astype(np.int64)


def _hidden(job: RenderJob, cell: np.ndarray) -> np.ndarray:
    if job.hidden is None:
        return np.zeros(len(cell), bool)
    return np.asarray((job.hidden.words[cell >> 5] >> (cell & 31).astype(np.uint32)) & 1 == 1)


def _index(grid: Grid, cell: np.ndarray) -> np.ndarray | None:
    if not grid.is_structured:
        return None
    index = np.stack(np.unravel_index(np.maximum(cell, 0), grid.shape), axis=-1)
    return np.where(cell[:, None] >= 0, index, -1)


def _values(
    job: RenderJob,
    volume: Volume,
    rows: dict[str, np.ndarray],
    cell: np.ndarray,
    hidden: np.ndarray,
    more: Any,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], dict[str, str]]:
    names, expressions = looked_at(job.medium)
    recorded = {n[6:]: v[:, 0] for n, v in rows.items() if n.startswith("field ")}

    def values(expr: Any) -> np.ndarray:
        if job.scheme.coefficients_at != "field":
            return in_cells(volume, expr, cell)
        return np.where(hidden, np.nan, on_the_ray(expr, recorded))

    fields = {e.text: values(e) for e in names}
    fields |= {e.text: in_cells(volume, e, cell) for e in more if e.text not in fields}
    scalars = {e.text: values(e) for e in expressions if e.text not in fields}
    return fields, scalars, units_of(volume, [*names, *more, *expressions])
