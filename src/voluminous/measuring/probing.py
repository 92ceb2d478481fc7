"""`probe`: one ray, with the fields, coefficients and intensity in each of its segments."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from numbers import Integral
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from ..backend import dr, from_host
from ..backend.functions import loop
from ..errors import InputError
from ..expressions import Expression, NumpyOps
from ..grids.arguments import on_grid
from ..grids.contract import cells_across
from ..grids.structured import is_structured
from ..grids.trees.vertices import LeafGrid
from ..large.partition import partition_of
from ..media.context import completed
from ..media.details import intensity_unit
from ..media.panel import PLACES
from ..media.sum import BoundSum
from ..progress import Progress, with_progress
from ..rendering import prepare
from ..rendering.job import RenderJob
from ..rendering.options import RenderOptions, background_array
from ..rendering.run import run
from ..rendering.tolerance import Rounds
from ..schemes.base import (
    Around,
    Position,
    Scanner,
    Scheme,
    Skipping,
    Solution,
    interpolated_at,
    is_controlled,
)
from ..schemes.channels import Channels
from ..schemes.channels import before as before_background
from ..schemes.path import Path, empty_path, over
from ..units import Unit, parse_unit, plain, unit_name
from .cells import CellQuantity
from .probe_result import Points, Probe

if TYPE_CHECKING:
    from ..backend.types import Float, Mask
    from ..cameras import Camera, Frame
    from ..grids.contract import Segment
    from ..media import Medium
    from ..regions import Region
    from ..rendering.partition import Partition
    from ..rendering.tracer import RayTracer
    from ..volume import Volume

Rows: TypeAlias = dict[str, np.ndarray]
"""Recorded numbers by name, of shape (segment, numbers), ordered from the observer on."""

# Points of a ray, of a cell at least and at most, and the part of the range of a curve to which it
# is straight between those that stay.
_POINTS, _PER_CELL, _STRAIGHT = 4000, (4, 64), 1e-3
# Recorded rows, in multiples of the cells that a straight line through the middle crosses.
_ROOM = 2


@with_progress
def probe(
    volume: Volume,
    medium: Medium,
    camera: Camera,
    pixel: tuple[int, int] | None = None,
    *,
    at: Any = None,
    also: str | Expression | Sequence[str | Expression] = (),
    scheme: str | Scheme | None = None,
    tolerance: float | None = 1e-3,
    background: Any = 0.0,
    clip: Region | str | None = None,
    precision: str = "single",
    device: str = "auto",
    cutoff: float | None = None,
    memory: Any = None,
    progress: Progress = None,
) -> Probe:
    """Return the segments of one ray, as `render` solves them.

    The ray passes through the medium alone. With `samples` a pixel of a picture is the mean of
    several rays, and with `objects` there are stars and lines between the segments; a probe has
    neither.

    Parameters
    ----------
    volume, medium, camera
        As for `render`.
    pixel : (int, int)
        ix and iy, counted from 0 at the lower left: the ray through the centre of
        ``image.intensity[iy, ix]``.
    at : (float, float) or Quantity, optional
        A point of the image plane instead, in the unit of its coordinates.
    also : str, Expression or sequence of them
        Further fields or expressions to return, with their values in the cells.
    scheme, tolerance, background, clip, precision, device, cutoff
        As for `render`. With a tolerance the whole picture is drawn, unless that has just been
        done: the tolerance of a pixel depends on the brightest one. With ``tolerance=None`` steps
        are as wide as those of the picture: up to eight cells, and none in empty space.
        ``cutoff=0`` follows the ray to its end.
    memory : str or int, optional
        As for `render`: of a volume larger than memory, the chunks along the ray are read. With a
        tolerance the whole picture is drawn first, unless that has been done: ``tolerance=None``
        or ``scheme="first-order"`` need nothing but the ray.
    progress : bool or callable, optional
        As for `render`.

    Returns
    -------
    Probe
        Arrays per segment; `Probe.table`, `Probe.plot`, and ``print(probe)``.

    Raises
    ------
    InputError, UnknownNameError, UnitsError
        For a pixel, point or field that does not exist, and for what `render` refuses.
    """
    partition = partition_of(volume, memory, medium)
    options = RenderOptions(
        scheme=scheme,
        tolerance=tolerance,
        clip=clip,
        precision=precision,
        device=device,
        cutoff=cutoff,
        progress=progress,
    )
    job, _ = prepare(partition.volume, medium, camera, options, partition)
    if at is not None and not camera.plane_unit:
        at = on_grid(at, volume.grid, "at")
    place = _place(pixel, at, job.frame, camera.plane_unit or volume.unit)
    seen = partition.volume
    listed = also if isinstance(also, (list, tuple)) else [also]
    quantities = [CellQuantity.of(seen, expr, "also") for expr in listed]
    more = [Expression.of_tree(q.expression.tree, q.expression.names, q.text) for q in quantities]
    behind = background_array(background, job.frame.pixels, job.medium.channels)
    (ix, iy), brightest = place.pixel, float(np.max(np.abs(behind)))
    flat = iy * job.frame.pixels[0] + ix
    tracer = _tracer_of(job, flat, brightest)
    ray = _follow_all(tracer, flat, place.offset)
    cells = ray
    if tracer.source.skipping.coarse:
        cells = _follow_all(_tracer_of(job, flat, brightest, by_cell=True), flat, place.offset)
    full = np.broadcast_to(behind, (*job.frame.pixels[::-1], job.medium.channels))
    made = _assembled(job, seen, place, ray, more, full[iy, ix])
    return replace(made, points=_points(job, tracer, made, cells))


class _Place(NamedTuple):
    """A point of the image plane and the pixel that contains it, or the nearest one."""

    pixel: tuple[int, int]
    offset: tuple[float, float]  # from the pixel's centre, in pixels
    at: tuple[float, float]


def _place(pixel: Any, at: Any, frame: Frame, unit: Unit) -> _Place:
    if (pixel is None) == (at is None):
        raise InputError("say which ray: pixel=(ix, iy), or at=(u, v) on the image plane")
    if pixel is not None:
        pair = tuple(pixel) if isinstance(pixel, (list, tuple)) or np.ndim(pixel) == 1 else ()
        whole = len(pair) == 2 and all(isinstance(i, Integral) for i in pair)
        if not whole or not all(0 <= i < n for i, n in zip(pair, frame.pixels, strict=True)):
            raise InputError(
                "pixel must be two whole numbers (ix, iy), counted from 0 at the lower left corner "
                f"of the image of {frame.pixels[0]} x {frame.pixels[1]} pixels, got {pixel!r}"
            )
        ix, iy = map(int, pair)
        u, v = (float(c[i]) for c, i in zip(frame.coordinates(), (ix, iy), strict=True))
        return _Place((ix, iy), (0.0, 0.0), (u, v))
    point = np.asarray(plain(at, unit, "at"))
    if point.shape != (2,) or not np.all(np.isfinite(point)):
        raise InputError(f"at must be two finite numbers (u, v) on the image plane, got {at!r}")
    count = np.array(frame.pixels)
    x = (point - frame.shift) / frame.pixel + 0.5 * (count - 1)
    nearest = np.clip(np.floor(x + 0.5), 0, count - 1).astype(int)
    (ix, iy), (dx, dy), (u, v) = nearest.tolist(), (x - nearest).tolist(), point.tolist()
    return _Place((ix, iy), (dx, dy), (u, v))


def solve_whole(
    scheme: Scheme, segment: Segment, source: Any, carried: list[Any]
) -> tuple[Solution, list[Any]]:
    """Return the solution of all of a segment, whether or not a scheme solves it in parts."""
    if not is_controlled(scheme):
        return scheme.solve(segment, source, carried)

    def unsolved(path: Path, carried: list[Any], left: Mask) -> Mask:
        return left

    def part(path: Path, carried: list[Any], left: Mask) -> tuple[Path, list[Any], Mask]:
        solution, carried = scheme.solve(segment, source, carried)
        return over(path, solution), carried, segment.unsolved

    channels = source.channels
    nothing = empty_path(source.backend.Float, channels.emissions, channels.extinctions, 3)
    path, carried, _ = loop((nothing, carried, segment.active), unsolved, part, label="panels")
    segment.unsolved = False
    return path, carried


class _Recorder(Around[Any], Scanner[Any]):
    """Wrap a scheme and write the solution of each segment to a row of some columns.

    Empty parts of a volume are recorded, too. The carried state is the number of segments so far,
    the coefficients at the end of the last segment (only for schemes with coefficients at
    vertices), and the wrapped scheme's state.
    """

    everywhere = True

    def __init__(self, scheme: Scheme, names: tuple[str, ...], capacity: int) -> None:
        super().__init__(scheme)
        self.names, self.capacity = names, capacity
        self.columns: dict[str, list[Float]] = {}
        self.own = 1

    def start(self, position: Position, source: Any) -> list[Any]:
        carried = [source.backend.UInt(0)]
        if self.coefficients_at == "vertex":
            corners = position.walk.entry_corners(position.track, position.cursor)
            carried += source.interpolate(corners, position.cursor.inside)
        self.own = len(carried)
        return [*carried, *self.scheme.start(position, source)]

    def make_columns(self, source: Any) -> None:
        """Make the columns, which are the same in all parts of a volume."""
        channels, backend = source.channels, source.backend
        counts = {"begin": 1, "end": 1, "cell": 1, "hidden": 1, "j": channels.emissions}
        counts |= dict.fromkeys(("alpha", "transparency", "tau"), channels.extinctions)
        counts["emission"] = channels.emissions
        if self.coefficients_at == "vertex":
            counts |= {"j ends": 2 * channels.emissions, "alpha ends": 2 * channels.extinctions}
        counts |= {f"field {name}": len(PLACES) for name in self.names}
        for name, count in counts.items():
            kind = backend.UInt if name == "cell" else backend.Wide
            self.columns[name] = [dr.zeros(kind, self.capacity) for _ in range(count)]
        dr.eval(self.columns)
        self.limit = dr.opaque(backend.UInt, self.capacity)

    def after_skip(
        self, position: Position, source: Any, carried: list[Float], moved: Mask
    ) -> list[Float]:
        (row, *before), inner = carried[: self.own], carried[self.own :]
        if before:
            before = interpolated_at(position, source, before, moved)
        return [row, *before, *self.scheme.after_skip(position, source, inner, moved)]

    def solve(
        self, segment: Segment, source: Any, carried: list[Float]
    ) -> tuple[Path, list[Float]]:
        (row, *before), inner = carried[: self.own], carried[self.own :]
        solution, inner = solve_whole(self.scheme, segment, source, inner)
        (j, alpha), fields, after = self._coefficients(source, segment, before)
        Wide, walk = source.backend.Wide, segment.walk
        begin, end = (
            (Wide(segment.track.entry) + Wide(t)) * Wide(walk.scale)
            for t in (segment.begin, segment.end)
        )
        cell = segment.own_cell  # wide steps are through many
        values = {"begin": [begin], "end": [end], "cell": [row if cell is None else cell]}
        values |= {"hidden": [dr.select(segment.hidden, Wide(1), Wide(0))]}
        j, alpha = ([dr.select(segment.hidden, 0.0, v) for v in own] for own in (j, alpha))
        values |= {"j": j, "alpha": alpha, "tau": solution.depth}
        values |= {"emission": solution.emission, "transparency": solution.transparency}
        values |= {f"field {name}": [places[name] for places in fields] for name in self.names}
        if self.coefficients_at == "vertex":
            ends = zip(*(source.channels.split(one) for one in (before, after)), strict=True)
            values |= dict(zip(("j ends", "alpha ends"), (a + b for a, b in ends), strict=True))
        # Not two walls in one place.
        recorded = segment.active & (segment.length > 0.0)
        recorded |= segment.hidden & (segment.end > segment.begin)
        for name, numbers in values.items():
            for column, number in zip(self.columns[name], numbers, strict=True):
                dr.scatter(column, type(column)(number), row, recorded & (row < self.limit))
        return solution, [row + dr.select(recorded, source.backend.UInt(1), 0), *after, *inner]

    def _coefficients(
        self, source: Any, segment: Segment, before: list[Float]
    ) -> tuple[Any, list[dict[str, Float]], list[Float]]:
        if self.coefficients_at == "cell":
            return source.at(segment), [], []
        if self.coefficients_at == "vertex":
            corners = segment.walk.exit_corners(segment.track, segment)
            after = list(source.interpolate(corners, segment.active))
            mean = [0.5 * (a + b) for a, b in zip(before, after, strict=True)]
            return source.channels.split(mean), [], after
        fields = source.along(segment)
        nodes, channels = [fields.node(s) for s in PLACES], source.channels
        if is_controlled(self.scheme):
            first, last, _ = channels.integrate(fields.panel(nodes))
            pairs = zip(first, last, strict=True)
            j, alpha = ([0.5 * (a + b) for a, b in zip(*own, strict=True)] for own in pairs)
        else:
            j, alpha = channels.means(fields.panel(nodes[::2], straight=True))
        context = source.context
        return (j, alpha), [completed(context.ops, fields.at(s), context) for s in PLACES], []

    def read(self, count: int) -> Rows:
        """Return the first ``count`` rows."""
        return {
            name: np.array([np.asarray(c)[:count] for c in columns]).reshape(len(columns), count).T
            for name, columns in self.columns.items()
        }


def _tracer_of(
    job: RenderJob, pixel: int, brightest_background: float, *, by_cell: bool = False
) -> RayTracer:
    """Return the tracer with which a pixel is finally drawn, or one that leaves out no cell.

    With error control its limits depend on the whole picture, so that is drawn, unless the volume
    remembers them.
    """
    rounds = None
    if job.controlled:
        rounds = job.cache.get(Rounds.key(job, brightest_background))
        if rounds is None:
            rounds = run(job, brightest_background).rounds
        else:
            job.progress(1, 1)
    source = copy.copy(job.source(rounds is not None and rounds.faintest))
    if by_cell or not source.skipping.coarse:  # steps are single cells: rays also visit empty ones
        source.skipping = Skipping()
    tracer = job.partition.tracer(job, source, brightest_background, False)
    if rounds is not None:
        allowed, source.channels.peaks = rounds.of(pixel)
        tracer.allow(*allowed)
    return tracer


class _Ray(NamedTuple):
    """A ray and its recorded segments."""

    origin: np.ndarray  # (3,)
    direction: np.ndarray  # (3,), away from the observer
    rows: Rows
    path: Path  # the result of the march, as numbers
    stopped: bool
    channels: Channels


def _follow_all(tracer: RayTracer, pixel: int, offset: tuple[float, float]) -> _Ray:
    """Return the ray with all groups of channels; some may end before others."""
    room = _ROOM * int(cells_across(tracer.job.volume.grid)) + 64
    rays = [_follow(part, pixel, offset, room) for _, part in tracer.parts()]
    if len(groups := tracer.groups) == 1:
        return rays[0]
    longest = max(rays, key=lambda ray: len(ray.rows["begin"]))
    emissions, extinctions, _ = tracer.counts
    rows, path = dict(longest.rows), tracer.nothing()
    for name in ("j", "alpha", "tau", "transparency", "emission"):
        count = emissions if name in ("j", "emission") else extinctions
        shape = (len(longest.rows[name]), count)
        rows[name] = np.full(shape, 1.0 if name == "transparency" else 0.0)
    for group, ray in zip(groups, rays, strict=True):
        grey = slice(0, 1) if extinctions == 1 else group
        for name in ("j", "emission"):
            rows[name][: len(ray.rows[name]), group] = ray.rows[name]
        for name in ("alpha", "tau", "transparency"):
            rows[name][: len(ray.rows[name]), grey] = ray.rows[name]
        path.emission[group] = ray.path.emission
        path.transparency[grey], path.depth[grey] = ray.path.transparency, ray.path.depth
    stopped = any(ray.stopped for ray in rays)
    return longest._replace(rows=rows, path=path, stopped=stopped, channels=tracer.source.channels)


def _follow(tracer: RayTracer, pixel: int, offset: tuple[float, float], capacity: int) -> _Ray:
    inner, job = tracer.scheme, tracer.job
    names = job.medium.names if inner.coefficients_at == "field" else ()
    tracer.scheme = recorder = _Recorder(inner, names, capacity)
    recorder.make_columns(tracer.source)
    place = tuple(np.array([value]) for value in (pixel, *offset))
    ray = tracer.ray_through(*place)
    followed = tracer.follow(*place, recorder.columns)
    tracer.scheme, found, over = inner, followed.path, followed.over
    count = followed.blocks[-1][1]
    if count > capacity:
        return _follow(tracer, pixel, offset, count)
    rows = recorder.read(count)
    first = 0
    for box, last in followed.blocks:  # in which cells have numbers of their own
        own = rows["cell"][first:last]
        shape = [high - low for low, high in zip(box.low, box.high, strict=True)]
        if inner.coefficients_at == "cell":
            index = np.array(np.unravel_index(own, shape)) + np.reshape(box.low, (-1, 1, 1))
            own[:] = np.ravel_multi_index(tuple(index), job.volume.grid.shape)
        first = last
    origin, direction = (
        np.array([float(np.asarray(part).reshape(-1)[0]) for part in vector])
        for vector in (ray.origin, ray.direction)
    )
    if job.backward:
        rows = {name: values[::-1] for name, values in rows.items()}
        rows |= {"begin": -rows["end"], "end": -rows["begin"]}
        for name in rows:
            if name.startswith("field "):
                rows[name] = rows[name][:, ::-1]
            elif name.endswith(" ends"):
                rows[name] = np.roll(rows[name], rows[name].shape[1] // 2, axis=1)
        direction = -direction
    parts = (found.emission, found.transparency, found.depth)
    path = Path(*([np.asarray(v)[0] for v in numbers] for numbers in parts))
    return _Ray(origin, direction, rows, path, bool(np.asarray(over)[0]), tracer.source.channels)


def _assembled(
    job: RenderJob,
    volume: Volume,
    place: _Place,
    ray: _Ray,
    more: list[Expression],
    background: np.ndarray,
) -> Probe:
    """Return a probe of the volume as the camera sees it, with the fields `more` asked for."""
    rows, path, grid, scheme = ray.rows, ray.path, volume.grid, job.scheme
    begin, end = rows["begin"][:, 0], rows["end"][:, 0]
    position = ray.origin + 0.5 * (begin + end)[:, None] * ray.direction
    cell, hidden = rows["cell"][:, 0].astype(np.int64), rows["hidden"][:, 0] > 0.0
    if job.hidden is None and scheme.coefficients_at == "field":  # between the cells' centres
        cell = np.asarray(grid.locate(position), dtype=np.int64)
    index = None
    if is_structured(grid):
        index = np.stack(np.unravel_index(np.maximum(cell, 0), grid.shape), axis=-1)
        index = np.where(cell[:, None] >= 0, index, -1)

    own = [Expression(name) for name in job.medium.names]
    known = [feature.expr for feature in job.medium.known_features() if feature.expr.names]
    asked = more if scheme.coefficients_at == "field" else [*own, *more, *known]
    values = _in_cells(job.partition, asked, cell)

    def in_cells(expr: Expression) -> np.ndarray:
        return np.array([values[expr.text].get(c, np.nan) for c in cell], dtype=np.float64)

    def on_the_ray(expr: Expression) -> np.ndarray:
        if scheme.coefficients_at != "field":
            return in_cells(expr)
        recorded = {name: rows[f"field {name}"][:, len(PLACES) // 2] for name in expr.names}
        with np.errstate(all="ignore"):
            values = np.asarray(expr.evaluate(NumpyOps(), recorded), dtype=np.float64)
        return np.where(hidden, np.nan, values)

    fields = {e.text: on_the_ray(e) for e in own}
    fields |= {e.text: in_cells(e) for e in more if e.text not in fields}
    scalars = {e.text: on_the_ray(e) for e in known if e.text not in fields}
    units = {e.text: unit_name(volume.expression_unit(e)) for e in (*own, *more, *known)}
    light = intensity_unit(job.medium, volume)
    units |= {"length": unit_name(volume.unit), "intensity": unit_name(parse_unit(light))}

    def mixed(emissions: list[np.ndarray]) -> np.ndarray:
        """Return the intensities of integrated emissions."""
        return np.asarray(ray.channels.intensity(emissions))

    b, theta = mixed(list(rows["emission"].T)).astype(np.float64), rows["transparency"]
    gathered, arriving = _folded(b, theta, background.astype(np.float64))
    through = np.stack(path.transparency)
    return Probe(
        begin=begin,
        end=end,
        position=position,
        cell=cell,
        index=index,
        level=np.where(cell >= 0, grid.levels[cell], 0)
        if isinstance(grid, LeafGrid)
        else np.zeros(len(cell), int),
        hidden=hidden,
        fields=fields,
        scalars=scalars,
        j=mixed(list(rows["j"].T)).astype(np.float64) / grid.scale,
        alpha=rows["alpha"] / grid.scale,
        tau=rows["tau"],
        theta=theta,
        b=b,
        depth=np.cumsum(rows["tau"], axis=0),
        gathered=gathered,
        arriving=arriving,
        background=np.array(background, dtype=np.float64),
        intensity=before_background(background, mixed(path.emission), through),
        transparency=through,
        optical_depth=np.stack(path.depth),
        stopped=ray.stopped,
        pixel=place.pixel,
        at=place.at,
        axes=tuple(grid.coordinates),
        units=units,
        provenance={**job.provenance(), "camera": job.camera.describe()},
    )


def _points(job: RenderJob, tracer: RayTracer, probe: Probe, ray: _Ray) -> Points:
    """Return values at points of a ray through all cells; NaN in hidden ones and in gaps."""
    begin, end, hidden = (ray.rows[name][:, 0] for name in ("begin", "end", "hidden"))
    by_field = job.scheme.coefficients_at == "field"
    names = [name for name in probe.fields if not by_field or name in job.medium.names]
    counts = [1, len(names), len(probe.scalars), probe.j.shape[1], probe.alpha.shape[1]]
    table = np.empty((sum(counts), 0))
    if len(begin):
        table = _along(job, tracer, probe, ray) if by_field else _at_ends(job, probe, ray)
        per = table.shape[1] // len(begin)
        table[1:, np.repeat(hidden > 0.0, per)] = np.nan
        gaps = np.flatnonzero(begin[1:] - end[:-1] > 1e-3 * (end - begin)[:-1])
        table = np.insert(table, (gaps + 1) * per, np.nan, axis=1)
        table[0, (gaps + 1) * per + np.arange(len(gaps))] = end[gaps]
        if by_field:
            table = table[:, _bends(table)]
    (distance,), fields, scalars, j, alpha = np.split(table, np.cumsum(counts)[:-1])
    by_name = dict(zip(names, fields, strict=True)), dict(zip(probe.scalars, scalars, strict=True))
    return Points(distance, by_name[0], by_name[1], j.T, alpha.T)


def _at_ends(job: RenderJob, probe: Probe, ray: _Ray) -> np.ndarray:
    """Return the values at both ends of each segment: those of its cell, or between vertices."""
    columns = [*probe.fields.values(), *probe.scalars.values(), *probe.j.T, *probe.alpha.T]
    table = np.repeat([probe.begin, *columns], 2, axis=1)
    table[0, 1::2] = probe.end
    channels, extinctions = probe.j.shape[1], probe.alpha.shape[1]
    ends = ray.rows.get("j ends")
    if ends is not None and ends.shape[1] == 2 * channels:  # not of groups of channels
        j = np.asarray(ray.channels.intensity(list(ends.reshape(-1, channels).T)))
        alpha = ray.rows["alpha ends"].reshape(-1, extinctions)
        table[-channels - extinctions :] = np.hstack([j, alpha]).T / job.volume.grid.scale
    return table


def _along(job: RenderJob, tracer: RayTracer, probe: Probe, ray: _Ray) -> np.ndarray:
    """Return values where fields are interpolated.

    Between the corners of a cell they are cubics along the ray, which five places determine.
    """
    begin, end = ray.rows["begin"], ray.rows["end"]
    t, order = np.linspace(0.0, 1.0, int(np.clip(_POINTS // len(begin), *_PER_CELL))), np.arange(5)
    weights = np.power.outer(t, order) @ np.linalg.inv(np.power.outer(PLACES, order))
    fields = {n: (ray.rows[f"field {n}"] @ weights.T).ravel() for n in job.medium.names}
    with np.errstate(all="ignore"):
        numbers = {n: Expression(n).evaluate(NumpyOps(), fields) for n in probe.scalars}
    channels, context = tracer.source.channels, tracer.source.context
    places = {name: from_host(tracer.backend.Wide, values) for name, values in fields.items()}
    parts = channels.bound.parts if isinstance(channels.bound, BoundSum) else [channels.bound]
    distance = (begin + (end - begin) * t).ravel()
    j, alpha = (np.zeros((n.shape[1], len(distance))) for n in (probe.j, probe.alpha))
    for part, surface in zip(parts, channels.surfaces, strict=True):
        if not surface:
            sample = part.coefficients(places, context)
            for total, rows in ((j, sample.emissivity), (alpha, sample.extinction)):
                total += np.array([np.zeros(len(distance)) + np.asarray(row) for row in rows])
    j *= np.reshape(channels.binding.radiance, (-1, 1)) / job.volume.grid.scale
    alpha /= job.volume.grid.scale
    for k in np.flatnonzero(probe.tau.max(axis=1) > 0.0) if any(channels.surfaces) else ():
        # A surface without width is a peak in its segment.
        nearest = np.argmin(np.abs(distance - 0.5 * (probe.begin[k] + probe.end[k])))
        j[:, nearest] = np.maximum(j[:, nearest], probe.j[k])
        alpha[:, nearest] = np.maximum(alpha[:, nearest], probe.alpha[k])
    scalars = [np.zeros(len(distance)) + values for values in numbers.values()]
    known = [fields[name] for name in probe.fields if name in fields]
    return np.array([distance, *known, *scalars, *j, *alpha])


def _bends(table: np.ndarray) -> np.ndarray:
    """Return the points between which curves are straight, logarithms of fields included."""
    x, y = table[0], table[1:]
    low, high = (
        f(y, axis=1, keepdims=True, initial=v)
        for f, v in ((np.nanmin, np.inf), (np.nanmax, -np.inf))
    )
    with np.errstate(all="ignore"):
        y = np.where(low > 0.0, np.log(y / low) / np.log(high / low), (y - low) / (high - low))
    y[np.ravel(~(high > low))] = 0.0
    kept, before = np.arange(len(x)), -1
    while len(kept) != before:
        before = len(kept)
        for first in (1, 2):
            at, rows = x[kept], y[:, kept]
            w = (at[1:-1] - at[:-2]) / np.maximum(at[2:] - at[:-2], 1e-300)
            off = np.abs(rows[:, 1:-1] - (1 - w) * rows[:, :-2] - w * rows[:, 2:]).max(axis=0)
            near = np.zeros(len(kept), bool)
            near[first:-1:2] = off[first - 1 :: 2] < _STRAIGHT
            kept = kept[~near]
    return kept


def _in_cells(
    partition: Partition, expressions: Sequence[Expression], cell: np.ndarray
) -> dict[str, dict[int, float]]:
    """Return the values of expressions in some cells, read block by block."""
    cells, shape = np.unique(cell[cell >= 0]), partition.volume.grid.shape
    index = np.stack(np.unravel_index(cells, shape), axis=-1)
    found: dict[str, dict[int, float]] = {expr.text: {} for expr in expressions}
    names = dict.fromkeys(name for expr in expressions for name in expr.names)
    for box in partition.blocks_of(names, 0, 0):
        inside = np.all((index >= box.low) & (index < box.high), axis=1)
        if not inside.any():
            continue
        part, numbers = partition.part(box, names), cells[inside].tolist()
        local = np.ravel_multi_index(tuple((index[inside] - box.low).T), part.grid.shape)
        for expr in expressions:
            values = (part.evaluate_cells(expr, c, c + 1)[0] for c in local.tolist())
            found[expr.text] |= dict(zip(numbers, values, strict=True))
    return found


def _folded(
    b: np.ndarray, theta: np.ndarray, background: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the intensity gathered from the segments up to each, and that in front of each.

    The latter comes from all behind it and the background. Pairs (b, θ) compose to
    (b₁ + θ₁ b₂, θ₁ θ₂).
    """
    before = np.cumprod(np.vstack([np.ones_like(theta[:1]), theta[:-1]]), axis=0)
    arriving, light = np.empty_like(b), background
    for k in reversed(range(len(b))):
        light = b[k] + theta[k] * light
        arriving[k] = light
    return np.cumsum(before * b, axis=0), arriving
