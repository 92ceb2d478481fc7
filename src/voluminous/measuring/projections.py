"""Scans along rays: the largest or smallest value, and where a condition or a depth is reached."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..drawing import render
from ..errors import InputError, check_flag, check_name
from ..large.partition import partition_of
from ..media import Coefficients
from ..progress import Progress, with_progress
from ..rendering import prepare
from ..rendering.options import RenderOptions, refuse_unusable
from ..rendering.run import make_tracer
from ..rendering.tracer import exhausted
from ..schemes import get_scheme
from ..schemes.base import Around, CellSource, Position, Scanner, Scheme, Source, Steps
from ..schemes.path import Path
from .cells import CellQuantity, check_volume, converted, undefined_as_missing
from .columns import Slab, as_map, column, distance, lines_of_sight
from .probing import solve_whole

if TYPE_CHECKING:
    from ..backend.types import Float, Mask
    from ..cameras import Camera
    from ..expressions import Expression
    from ..grids.contract import Grid, Segment
    from ..image import Image
    from ..media import Medium
    from ..regions import Region
    from ..units import UnitLike
    from ..volume import Volume


NOTHING = Path([], [], [])


def scan(
    volume: Volume, medium: Medium, camera: Camera, scheme: Scanner, memory: Any, **options: Any
) -> tuple[np.ndarray, float]:
    """Return the results of rays through the centres of pixels, and the unit of coefficients.

    Results are of shape (k, ny, nx) and type float64. Coefficients are in this unit, and distances
    in that of the grid's scale: single precision may not hold them in units of the volume.
    """
    partition = partition_of(volume, memory, medium)
    drawn = RenderOptions(scheme=scheme, cutoff=0.0, **options)
    job, _ = prepare(partition.volume, medium, camera, drawn, partition)
    nx, ny = job.frame.pixels
    tracer = make_tracer(job, 0.0)
    values = np.stack(exhausted(tracer.batches()).emission).astype(np.float64).reshape(-1, ny, nx)
    return values, float(np.max(tracer.source.channels.unit)) / volume.grid.scale


_SIGNS = {"max": 1.0, "min": -1.0}
HOW = ("max", "min", "first", "integral", "mean")


@with_progress
def project(
    volume: Volume,
    quantity: str | Expression,
    camera: Camera,
    how: str = "max",
    *,
    depth: bool = False,
    slab: Any = None,
    clip: Region | str | None = None,
    unit: UnitLike = None,
    precision: str = "single",
    memory: Any = None,
    device: str = "auto",
    progress: Progress = None,
) -> Image | tuple[Image, Image]:
    """Return a projection of a quantity along the lines of sight, such as its maximum.

    A quantity is constant in a cell. Cells without a value (NaN) are left out.

    Parameters
    ----------
    volume, quantity, camera
        As for `column`. For ``how="first"`` a condition such as ``"density > 1e-18"``, which holds
        where it is not zero; numbers may have units on the right of a comparison.
    how : {"max", "min", "first", "integral", "mean"}
        ``"max"`` is the maximum-intensity projection (MIP), ``"min"`` the minimum; ``"integral"``
        is ∫ q ds, as `column` gives it; ``"mean"`` is ∫ q ds / ∫ ds over cells with a value.
        ``"first"`` is the distance at which rays enter the first cell in which the condition holds.
    depth : bool
        For ``"max"`` and ``"min"``: return also where the extreme is, as a second map. Distances
        are those of the middle of the cell's chord from the observer; for an orthographic camera
        from the plane through its centre, away from the observer.
    slab : (distance, thickness), optional
        As for `column`: a thick slab, across the view of an orthographic camera.
    clip : Region or str, optional
        As for `column`.
    unit : str or unit, optional
        Of the map, as for `column`; where there are two, of the extremes.
    precision, device, progress
        As for `render`.
    memory : str or int, optional
        As for `render`: the volume is read and drawn chunk by chunk, with the same bits.

    Returns
    -------
    Image or (Image, Image)
        One channel, shape (ny, nx, 1), in the unit of the quantity, for ``"integral"`` times a
        length, for ``"first"`` a length. NaN where a line of sight misses everything; 0 for
        ``"integral"``.

    Raises
    ------
    UnknownNameError
        For a field or projection that does not exist; names the nearest.
    InputError
        If there is no depth of such a projection, or the quantity has no value in any cell.
    UnitsError
        If the map is not of the unit.

    Examples
    --------
    >>> import numpy as np
    >>> import voluminous as vm
    >>> grid = vm.CartesianGrid.uniform((2, 2, 2), (0, 1))
    >>> volume = vm.Volume(grid, a=np.arange(8.0).reshape(2, 2, 2))
    >>> camera = vm.Orthographic(width=1, resolution=2)
    >>> vm.project(volume, "a", camera, how="max").intensity[..., 0].tolist()
    [[1.0, 5.0], [3.0, 7.0]]
    """
    check_name("how", how, HOW)
    check_volume(volume)
    check_flag("depth", depth)
    if depth and how not in _SIGNS:
        raise InputError(f"depth=True is for how='max' and 'min', got how={how!r}")
    options: dict[str, Any] = {"precision": precision, "device": device, "progress": progress}
    options["memory"] = memory
    if how in ("integral", "mean"):
        options |= {"weight": 1 if how == "mean" else None, "slab": slab, "clip": clip}
        total = column(volume, quantity, camera, unit=unit, **options)
        return total.replace(provenance={**(total.provenance or {}), "how": how})
    options["clip"] = Slab.within(slab, clip)
    first = how == "first"
    named = "condition" if first else "quantity"
    volume = partition_of(volume, memory).volume
    seen = volume.seen_by(camera)
    what = CellQuantity.of(seen, quantity, named)
    seen, (known,) = undefined_as_missing(seen, [what.expression], memory)
    scheme = _First() if first else _Largest(_SIGNS[how])
    (best, *places), own = scan(seen, Coefficients(known, 0), camera, scheme, **options)
    scale = volume.grid.scale
    provenance: dict[str, Any] = {named: what.text, "how": how}
    provenance |= {} if slab is None else {"slab": [str(one) for one in slab]}
    provenance |= {} if clip is None else {"clip": str(clip)}
    kind = "distance" if first else f"{how}imum of {what.text!r}"
    target, factor = converted(volume.unit if first else what.unit, unit, f"the {kind}")
    label = "depth" if first else f"{how}imum of {what.text}"
    size = factor * (scale if first else own)
    image = as_map(size * best, target, volume, camera, {**provenance, "map": label})
    if not depth:
        return image
    return image, as_map(
        scale * places[0], volume.unit, volume, camera, {**provenance, "map": "depth"}
    )


# Options that `render` and `project` have both.
SHARED = ("clip", "precision", "device", "memory", "progress")


def drawn(
    volume: Volume,
    medium: Medium,
    camera: Camera,
    projection: Mapping[str, Any] | None = None,
    **options: Any,
) -> Image:
    """Return the picture of a medium or, with arguments of `project`, a projection.

    Of the options of `render`, those of colours and of accuracy have no meaning for a projection.
    """
    if not projection:
        return render(volume, medium, camera, **options)
    shared = {name: options[name] for name in SHARED if name in options}
    made: Any = project(volume, camera=camera, **projection, **shared)
    image: Image = made
    return image


class _Largest(Scanner[CellSource]):
    """Carry the largest value, times a sign, and where it is."""

    name = "extreme"
    everywhere = True

    def __init__(self, sign: float) -> None:
        self.sign = sign

    def results(self, extinctions: int) -> list[float]:
        return [np.nan, np.nan]

    def start(self, position: Position, source: CellSource) -> list[Float]:
        return [source.backend.Float(np.nan), source.backend.Float(np.nan)]

    def solve(
        self, segment: Segment, source: CellSource, carried: list[Float]
    ) -> tuple[Path, list[Float]]:
        (value,), _ = source.at(segment)
        best, place = carried
        larger = dr.isnan(best) | (value * self.sign > best * self.sign)
        larger &= segment.active & (segment.length > 0.0)
        here = distance(segment.track, 0.5 * (segment.begin + segment.end))
        return NOTHING, [dr.select(larger, value, best), dr.select(larger, here, place)]


class _First(Scanner[CellSource]):
    """Carry where rays enter the first cell with a number that is not zero."""

    name = "first hit"

    def results(self, extinctions: int) -> list[float]:
        return [np.nan]

    def start(self, position: Position, source: CellSource) -> list[Float]:
        return [source.backend.Float(np.nan)]

    def solve(
        self, segment: Segment, source: CellSource, carried: list[Float]
    ) -> tuple[Path, list[Float]]:
        (value,), _ = source.at(segment)
        hit = dr.isnan(carried[0]) & (value != 0.0) & segment.active & (segment.length > 0.0)
        return NOTHING, [dr.select(hit, distance(segment.track, segment.begin), carried[0])]


@dataclass(frozen=True)
class TauSurface:
    """Where the optical depth from the observer reaches a value.

    Attributes
    ----------
    depth : Image
        One channel per extinction: the distance from the observer, or, for an orthographic camera,
        from the plane through its centre, away from the observer. NaN where it is not reached.
    points : float64 array (ny, nx, channel, 3)
        Its places, in the volume's coordinates.
    tau : float
    """

    depth: Image
    points: np.ndarray = field(repr=False)
    tau: float


@with_progress
def tau_surface(
    volume: Volume,
    medium: Medium,
    camera: Camera,
    tau: float = 1.0,
    *,
    wavelengths: Any = None,
    frequencies: Any = None,
    velocities: Any = None,
    clip: Region | str | None = None,
    scheme: str | Scheme = "first-order",
    precision: str = "double",
    memory: Any = None,
    device: str = "auto",
    progress: Progress = None,
) -> TauSurface:
    """Return where the optical depth, counted from the observer, reaches `tau`.

    Between the ends of a segment it is linear, as in RADMC-3D's ``tausurf``; in first order, where
    the extinction is constant in a cell, that is exact.

    Parameters
    ----------
    volume, medium, camera
        As for `render`.
    tau : float
        Positive.
    wavelengths, frequencies, velocities : optional
        One of them, of spectral media, as in `observe`: the map has a channel for each.
    scheme : str
        Computes the optical depths of segments; see `render`.
    clip, precision, memory, device, progress
        As for `render`.

    Returns
    -------
    TauSurface
        The map `depth`, and `points` in space.

    Raises
    ------
    InputError
        If `tau` is not positive, coefficients are not finite, or extinctions negative.
    """
    if not isinstance(tau, Real) or not 0 < tau <= 1e308:
        raise InputError(f"tau must be a positive number, got {tau!r}")
    channels = {"wavelengths": wavelengths, "frequencies": frequencies, "velocities": velocities}
    if any(given is not None for given in channels.values()):
        from ..observing.cubes import tuned

        medium = tuned(volume, medium, **channels)
    surface = _Surface(get_scheme(scheme, controlled=False), float(tau))
    options: dict[str, Any] = {"precision": precision, "device": device, "progress": progress}
    options |= {"memory": memory, "clip": clip}
    results, _ = scan(volume, medium, camera, surface, **options)
    places, depths = np.split(results, 2)
    if np.isnan(depths).any():  # else it would seem that the surface is not reached
        refuse_unusable(precision)
    provenance = {"tau": float(tau), "scheme": surface.scheme.name, "map": "depth"}
    distances = volume.grid.scale * np.moveaxis(places, 0, -1)
    depth = as_map(distances, volume.unit, volume, camera, provenance)
    origin, direction = (a[:, :, None] for a in lines_of_sight(camera, volume.grid))
    points = origin + depth.intensity[..., None] * direction
    return TauSurface(depth, np.asarray(points), float(tau))


class _Surface(Around[Source], Scanner[Source]):
    """Carry where an optical depth is reached, the depths so far, and a scheme's own numbers."""

    def __init__(self, scheme: Scheme[Source], tau: float) -> None:
        super().__init__(scheme)
        self.name, self.tau = f"{scheme.name} surface", tau

    def steps(self, grid: Grid) -> Steps:
        return Scheme.steps(self, grid)  # depths count from the observer

    def results(self, extinctions: int) -> list[float]:
        return [np.nan] * extinctions + [0.0] * extinctions

    def start(self, position: Position, source: Source) -> list[Float]:
        found = self.results(source.channels.extinctions)
        self.own, self.limit = len(found), source.backend.opaque(self.tau)
        return [*map(source.backend.Float, found), *self.scheme.start(position, source)]

    def after_skip(
        self, position: Position, source: Source, carried: list[Float], moved: Mask
    ) -> list[Float]:
        inner = self.scheme.after_skip(position, source, carried[self.own :], moved)
        return [*carried[: self.own], *inner]

    def solve(
        self, segment: Segment, source: Source, carried: list[Float]
    ) -> tuple[Path, list[Float]]:
        count = self.own // 2
        places, depths, inner = carried[:count], carried[count : self.own], carried[self.own :]
        solution, inner = solve_whole(self.scheme, segment, source, inner)
        after = [d + more for d, more in zip(depths, solution.depth, strict=True)]

        def reached(place: Float, before: Float, after: Float, more: Float) -> Float:
            hit = dr.isnan(place) & (after >= self.limit) & segment.active
            part = (self.limit - before) / dr.select(hit, more, 1.0)
            here = dr.fma(dr.select(part < 1.0, part, 1.0), segment.length, segment.begin)
            return dr.select(hit, distance(segment.track, here), place)

        return NOTHING, [*map(reached, places, depths, after, solution.depth), *after, *inner]
