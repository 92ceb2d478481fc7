"""Columns and moments: integrals along the lines of sight, and weighted means."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import from_host, get_backend
from ..cameras import Orthographic
from ..cameras.contract import check_camera
from ..drawing import image_wcs, render
from ..errors import InputError, check_name
from ..expressions import product, shifted
from ..grids.contract import BoxGrid
from ..image import Image
from ..image.metadata import oriented
from ..large.partition import partition_of
from ..media import Coefficients
from ..packages import version
from ..progress import Progress, with_progress
from ..regions import Region, region_of
from ..rendering.partition import check_finite
from ..schemes.base import CellSource, Scanner, Solution
from ..units import Unit, UnitLike, plain, shown, unit_name
from .cells import (
    CellParts,
    CellQuantity,
    blocks,
    check_volume,
    converted,
    integral_unit,
    undefined_as_missing,
)
from .exact_projection import Screen, empty_sums, project_cells, received

if TYPE_CHECKING:
    from ..backend.types import Float
    from ..cameras import Camera
    from ..expressions import Expression
    from ..grids.contract import Grid, Ray, Segment, Track
    from ..volume import Volume


def distance(track: Track, t: Float) -> Float:
    """Return how far a point of a ray is from its origin, in units of the scale (traced)."""
    return type(t)(track.entry + t)


class Slab(Region):
    """The part of each ray around a distance, of a thickness: a region for rays alone."""

    def __init__(self, slab: Any) -> None:
        if not (isinstance(slab, (list, tuple)) and len(slab) == 2):
            raise InputError(f"slab is a distance and a thickness, got {shown(slab)}")
        self.slab = slab

    @classmethod
    def within(cls, slab: Any, clip: Any) -> Any:
        """Return a clip that is also confined to a slab, if there is one."""
        if slab is None:
            return clip
        clip = region_of(clip) if isinstance(clip, str) else clip
        return cls(slab) if clip is None else cls(slab) & clip

    def lengths(self) -> Iterator[tuple[str, Any]]:
        yield "slab", self.slab[1]

    def numbers(self, unit: Unit) -> list[Any]:
        middle, thickness = (np.asarray(plain(one, unit, "slab")) for one in self.slab)
        one_number = middle.ndim == thickness.ndim == 0
        if not (one_number and np.isfinite(middle) and 0.0 < thickness < np.inf):
            raise InputError(
                f"a slab needs a finite distance and a thickness > 0, got {self.slab!r}"
            )
        return [[middle - 0.5 * thickness, middle + 0.5 * thickness]]

    def stretches(self, ray: Ray, numbers: Iterator[list[Float]]) -> list[tuple[Float, Float]]:
        first, last = next(numbers)
        return [(first, last)]


class Thin(Scanner[CellSource]):
    """Nothing is absorbed: b = j s. Quantities may be negative.

    Exact, up to rounding, for quantities that are constant in cells. A third faster than first
    order with an extinction of zero.
    """

    name = "column"

    def solve(
        self, segment: Segment, source: CellSource, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        emissivity, none = source.at(segment)
        one, zero = type(segment.length)(1), type(segment.length)(0)
        columns = [q * segment.length for q in emissivity]
        return Solution(columns, [one for _ in none], [zero for _ in none]), carried


METHODS = ("rays", "exact")
# Points along each axis at which cells on the surface of a clip are tested.
CUT = 4
# Cells projected at once, which limits the memory for their places.
_CHUNK = 1 << 21


def integrals(
    volume: Volume,
    expressions: Sequence[Expression],
    camera: Camera,
    method: str,
    **options: Any,
) -> np.ndarray:
    """Return ∫ q ds for each expression q, float64 of shape (k, ny, nx).

    They are plain numbers, with lengths in the volume's unit. Cells where one of them has no value
    count nothing for all: means are over known values.
    """
    check_camera(camera, "a map")  # of None `render` would make one
    check_name("method", method, METHODS)
    if method == "exact":
        check_exact(volume.grid, camera)
        how, seen = (options["device"], options["memory"]), volume.seen_by(camera)
        parts = None
        if options["clip"] is not None:
            parts = CellParts(seen, None, options["clip"], max(options["samples"], CUT))
        return exact_maps(seen, expressions, camera, *how, parts, together=True)
    seen, known = undefined_as_missing(volume.seen_by(camera), expressions, options["memory"])
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="the picture shows nothing of the medium")
        image = render(seen, Coefficients(known, 0), camera, scheme=Thin(), cutoff=0.0, **options)
    if not image.intensity.any():
        warnings.warn(
            f"{' and '.join(q.text for q in expressions)}: zero along every ray of this camera, "
            "which looks elsewhere, or whose pixels meet nothing of what is small",
            stacklevel=4,
        )
    return np.moveaxis(image.intensity, -1, 0).astype(np.float64)


def exact_maps(
    volume: Volume,
    expressions: Sequence[Expression | None],
    camera: Camera,
    device: str,
    memory: Any = None,
    parts: CellParts | None = None,
    together: bool = False,
) -> np.ndarray:
    """Return the mean columns of pixels, by projecting all cells; None stands for one everywhere.

    `parts` is the part of each cell that counts. With `together`, cells in which any of the
    expressions has no value are left out.
    """
    grid, frame = volume.grid, camera.frame(volume.grid)
    backend, screen = get_backend(device, "double"), Screen.of(frame)
    sums = empty_sums(screen, len(expressions))
    names = [name for expression in expressions if expression for name in expression.names]
    names += [] if parts is None else parts.names
    step = _CHUNK if memory is None else _CHUNK >> 2
    for block in blocks(partition_of(volume, memory), names, step, parts):
        part = block.volume
        for first, last in block.ranges:
            sizes = np.asarray(part.grid.cell_sizes(first, last))
            # In units of the scale: products of three lengths and a density may be too large, or
            # small.
            share = np.prod(sizes / grid.scale, axis=0)
            if parts is not None:
                share = share * parts.of(part, first, last)
            values = np.ones((len(expressions), last - first))
            for own, expression in zip(values, expressions, strict=True):
                if expression is not None:
                    own[:] = part.evaluate_cells(expression, first, last, double=True)
                    counts = np.where(share == 0, 0.0, own)
                    check_finite(part, counts, expression, first, block.low)
            unknown = np.isnan(values)
            if together:
                unknown = np.any(unknown, axis=0)
            amounts = np.where(unknown | (share == 0), 0.0, values) * share
            centers = np.asarray(part.grid.cell_centers(first, last))
            project_cells(screen, centers, sizes, amounts, backend, sums)
    total = received(screen, sums)
    return np.asarray(total / np.prod(np.asarray(frame.pixel) / grid.scale) * grid.scale)


def check_exact(grid: Grid, camera: Camera) -> None:
    """Refuse cameras and grids that exact maps do not support."""
    if not isinstance(camera, Orthographic):
        raise InputError(
            f"method='exact' needs parallel lines of sight (vm.Orthographic), got "
            f"{type(camera).__name__}; use method='rays' with samples"
        )
    if not isinstance(grid, BoxGrid) or tuple(grid.coordinates) != ("x", "y", "z"):
        raise InputError(
            f"method='exact' needs cells that are boxes, got a {type(grid).__name__}; use "
            "method='rays' with samples"
        )


def as_map(
    values: np.ndarray, unit: Unit, volume: Volume, camera: Camera, provenance: dict[str, Any]
) -> Image:
    """Return an image of numbers per pixel; its colour bar is labelled ``provenance["map"]``."""
    frame = camera.frame(volume.grid)
    x, y = frame.coordinates()
    common = {"software": f"voluminous {version()}", "volume": volume.describe()}
    return Image(
        values,
        x=x,
        y=y,
        pixel_size=frame.pixel,
        unit=camera.plane_unit or unit_name(volume.unit),
        intensity_unit=unit_name(unit),
        camera=camera.describe(),
        wcs=image_wcs(volume, camera, frame),
        provenance={**common, **oriented(volume.meta), **provenance},
    )


@with_progress
def column(
    volume: Volume,
    quantity: str | Expression,
    camera: Camera,
    *,
    weight: str | Expression | float | None = None,
    clip: Region | str | None = None,
    method: str = "rays",
    samples: int = 1,
    slab: Any = None,
    unit: UnitLike = None,
    precision: str = "single",
    memory: Any = None,
    device: str = "auto",
    progress: Progress = None,
) -> Image:
    """Return a map of ∫ q ds, or of ∫ q w ds / ∫ w ds, along the lines of sight.

    A quantity is constant in a cell. Where it is missing (NaN) or undefined, it counts nothing.

    Parameters
    ----------
    volume : Volume
        Grid and fields.
    quantity : str or Expression
        A field or an expression, of either sign; ``los("velocity")`` is the velocity away from the
        observer.
    camera : Orthographic or Perspective
        The lines of sight, and the pixels.
    weight : str or Expression, optional
        Return the mean of the quantity with this weight; NaN where the weight is zero.
    clip : Region or str, optional
        As for `render`: only what is inside counts. Rays end at its surface; in exact maps cells on
        the surface count in part, as for `measure`.
    method : {"rays", "exact"}
        Rays through the pixels' centres (or parts of them, see `samples`); or the mean over the
        area of each pixel, from the shadows of all cells in closed form. Then the sum over all
        pixels times their area equals that over cells times their volumes to rounding, from any
        direction and with pixels of any size. Exact maps need an orthographic camera, and cells
        that are boxes.
    samples : int
        For rays: n for n × n rays per pixel, which converge to the exact mean.
    slab : (distance, thickness), optional
        For rays: only this layer counts, lengths or numbers in the volume's unit. The distance of
        its middle is that along the ray from the observer, for an orthographic camera from the
        plane through its centre, away from the observer. Cells are cut where it begins and ends.
    unit : str or unit, optional
        Of the map; by default that of the quantity times the unit of length in it: g / cm2 for
        g / cm3, whatever the unit of the volume's lengths.
    precision, device, progress
        As for `render`; for rays.
    memory : str or int, optional
        As for `render`: the volume is read and measured chunk by chunk. Rays give the same bits;
        exact maps the same to rounding: the order of their sums is another.

    Returns
    -------
    Image
        One channel, shape (ny, nx, 1).

    Raises
    ------
    UnknownNameError
        For a field or method that does not exist.
    InputError
        If the exact method cannot be used, or the quantity is infinite in a cell.
    UnitsError
        If the map is not of the unit.
    """
    how: dict[str, Any] = {"method": method, "samples": samples}
    options = {**how, "precision": precision, "device": device, "progress": progress}
    options |= {"memory": memory, "clip": Slab.within(slab, clip)}
    check_volume(volume)
    if slab is not None:
        if method == "exact":
            raise InputError("slab= is for method='rays': exact maps are of all the volume")
        how["slab"] = [str(one) for one in slab]
    volume = partition_of(volume, memory).volume
    seen = volume.seen_by(camera)
    what = CellQuantity.of(seen, quantity)
    provenance = {"quantity": what.text, **how}
    if clip is not None:
        provenance["clip"] = str(clip)
    if weight is None:
        provenance["map"] = f"column of {what.text}"
        own, factor = integral_unit(what.unit, volume.unit)
        values = integrals(volume, [what.number], camera, **options)[0]
    else:
        by = CellQuantity.of(seen, weight, "weight")
        provenance |= {"weight": by.text, "map": f"mean of {what.text}"}
        own, factor = what.unit, 1.0
        weighted = product(what.number, by.number)
        total, weights = integrals(volume, [weighted, by.number], camera, **options)
        with np.errstate(invalid="ignore", divide="ignore"):
            values = np.where(weights != 0, total / weights, np.nan)
    target, more = converted(own, unit, f"the column of {what.text!r}")
    return as_map(factor * more * values, target, volume, camera, provenance)


_HIGHEST = 4


@dataclass(frozen=True)
class Moments:
    """Moments of a velocity with the weight of a quantity.

    Attributes
    ----------
    column : Image
        ∫ q ds.
    mean : Image or None
        ⟨v⟩ = ∫ q v ds / ∫ q ds.
    dispersion : Image or None
        σ = √⟨(v - ⟨v⟩)²⟩.
    central : tuple of Image
        ⟨(v - ⟨v⟩)ᵏ⟩ for k = 2, 3, … as asked for.
    """

    column: Image
    mean: Image | None = None
    dispersion: Image | None = None
    central: tuple[Image, ...] = ()

    def __iter__(self) -> Iterator[Image]:
        """Give column, mean and dispersion, as far as they were asked for."""
        return iter([m for m in (self.column, self.mean, self.dispersion) if m is not None])


@with_progress
def moments(
    volume: Volume,
    quantity: str | Expression,
    camera: Camera,
    velocity: str | Expression = "velocity",
    n: int = 2,
    *,
    clip: Region | str | None = None,
    method: str = "rays",
    samples: int = 1,
    precision: str = "double",
    memory: Any = None,
    device: str = "auto",
    progress: Progress = None,
) -> Moments:
    """Return the first moments of a velocity along the lines of sight.

    Parameters
    ----------
    volume, quantity, camera
        As for `column`; the quantity is the weight, such as ``"density"``.
    velocity : str or Expression
        A vector (its component along the line of sight is taken, positive away from the observer),
        or any expression.
    n : int
        The highest moment: 0 for the column, 1 for the mean too, 2 for the dispersion, up to 4.
    clip, method, samples, precision, memory, device, progress
        As for `column`. Dispersions are differences: take double precision.

    Returns
    -------
    Moments
        Images `column`, `mean` and `dispersion`; NaN where the column is zero.

    Raises
    ------
    InputError
        If `n` is not from 0 to 4.
    """
    if not isinstance(n, Integral) or not 0 <= n <= _HIGHEST:
        raise InputError(f"n, the highest moment, must be from 0 to {_HIGHEST}, got {n!r}")
    check_volume(volume)
    check_camera(camera, "a map")
    volume = partition_of(volume, memory).volume
    seen = volume.seen_by(camera)
    if isinstance(velocity, str) and velocity not in seen and f"los({velocity!r})" in seen:
        velocity = f"los({velocity!r})"
    weight, speed = CellQuantity.of(seen, quantity), CellQuantity.of(seen, velocity, "velocity")
    middle = _typical(seen, weight, speed)
    v = shifted(speed.number, -middle)
    powers = [product(weight.number, *[v] * k) for k in range(n + 1)]
    how: dict[str, Any] = {"method": method, "samples": samples}
    options: dict[str, Any] = {"precision": precision, "device": device, "progress": progress}
    options |= {"memory": memory, "clip": clip}
    sums = integrals(volume, powers, camera, **how, **options)

    def image(values: np.ndarray, unit: Unit, what: str) -> Image:
        provenance = {"quantity": weight.text, "velocity": speed.text, **how, "map": what}
        return as_map(values, unit, volume, camera, provenance)

    unit, factor = integral_unit(weight.unit, volume.unit)
    column = image(factor * sums[0], unit, "column")
    with np.errstate(invalid="ignore", divide="ignore"):
        raw = [np.where(sums[0] != 0, s / sums[0], np.nan) for s in sums]
    if n == 0:
        return Moments(column)
    mean = image(middle + raw[1], speed.unit, "mean velocity")
    if n == 1:
        return Moments(column, mean)
    central = [_central(raw, k) for k in range(2, n + 1)]
    dispersion = image(np.sqrt(np.maximum(central[0], 0.0)), speed.unit, "dispersion")
    images = tuple(
        image(moment, None if speed.unit is None else speed.unit**k, f"central moment {k}")
        for k, moment in enumerate(central, 2)
    )
    return Moments(column, mean, dispersion, images)


def _typical(volume: Volume, weight: CellQuantity, speed: CellQuantity) -> float:
    """Return a velocity to subtract from all, so that squares of small differences keep digits.

    The mean of some cells will do, since it is added again. Absolute weights are taken: those of
    both signs could add up to nearly zero, and the quotient exceed all velocities.
    """
    last = min(volume.grid.size, 1 << 16)
    w, v = (volume.evaluate_cells(q.expression, 0, last) for q in (weight, speed))
    w = np.abs(w)
    total = float(np.nansum(w))
    with np.errstate(all="ignore"):  # a quotient by a density that is zero, say
        mean = float(np.nansum(w * v)) / total if total else 0.0
    return mean if np.isfinite(mean) else 0.0


def _central(raw: list[np.ndarray], k: int) -> np.ndarray:
    """Return ⟨(v - m)ᵏ⟩, with m = raw[1], from the moments about another point."""
    terms = [math.comb(k, i) * (-raw[1]) ** (k - i) * raw[i] for i in range(2, k + 1)]
    # The terms of i = 0 and 1 are (-m)ᵏ and -k (-m)ᵏ.
    return sum(terms, (1 - k) * (-raw[1]) ** k)


def lines_of_sight(camera: Camera, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and unit directions of the rays, each of shape (ny, nx, 3).

    Directions run away from the observer. Distances along a ray count from its origin: the
    observer, or the plane through the centre of an orthographic camera.
    """
    frame, backend = camera.frame(grid), get_backend("cpu", "double")
    u, v = (a.ravel() for a in np.meshgrid(*frame.coordinates()))
    places = (from_host(backend.Wide, place) for place in (u, v))
    ray = camera.rays(frame.traced_vectors(backend), *places)
    nx, ny = frame.pixels

    def stacked(parts: Sequence[Float]) -> np.ndarray:
        rows = [np.broadcast_to(np.asarray(p), u.shape) for p in parts]
        return np.stack(rows, axis=-1).reshape(ny, nx, 3)

    return stacked(ray.origin), stacked(ray.direction)
