"""Which level of a volume a picture is drawn from."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import from_host, get_backend
from ..calibration import calibrated
from ..cameras.contract import check_camera
from ..errors import InputError
from ..expressions.interval import Interval
from ..grids.cartesian.grid import CartesianGrid
from ..levels import kept_level
from ..media.bound import Binding
from ..media.contract import Medium
from ..media.ranges import RangeContext
from ..rendering.cache import Cache
from ..volume import Volume

if TYPE_CHECKING:
    from ..cameras.contract import Camera, Frame

# Pixels along each side of a picture whose rays tell how wide pixels are.
_PROBES = 9


def at_level(volume: Any, medium: Any, camera: Any, level: Any) -> tuple[Any, Any, int]:
    """Return a level of a volume, the medium with numbers measured in the volume, the level.

    Media are the same at all levels, so that pictures show the same.
    """
    auto = isinstance(level, str) and level == "auto"
    if not auto and (type(level) is not int or level < 0):
        raise InputError(
            "level is 'auto', or the number of a coarser level of the file, 0 for all cells, got "
            f"{level!r}"
        )
    if not isinstance(volume, Volume) or not isinstance(medium, Medium):
        return volume, medium, 0  # which are refused
    check_camera(camera, "render")
    if auto:
        level = sufficient_level(volume, medium, camera)
    if level == 0:
        return volume, medium, level
    coarse: Volume = kept_level(volume, level)
    return coarse, calibrated(medium, volume, Cache(volume).measurements), level


def sufficient_level(volume: Volume, medium: Medium, camera: Camera) -> int:
    """Return the coarsest level whose cells are no wider than a pixel, at the nearest one.

    The nearest is that of the chunks in which the medium may be visible, if the file tells their
    ranges; of all of them if it does not. Cells that are nearer to a camera than they are wide are
    never narrower than a pixel: that is level 0.
    """
    grid = volume.grid
    if not isinstance(grid, CartesianGrid) or volume.store.levels == 1:
        return 0
    width, angle, origins = _pixel_sizes(camera, camera.frame(grid))
    if angle > 0.0:
        low, high = _visible_boxes(volume, medium)
        between = np.maximum(low - origins[1], origins[0] - high)
        away = np.linalg.norm(np.maximum(between, 0.0), axis=-1)
        width += angle * float(np.min(away, initial=np.inf))
    store = volume.store
    sides = np.ptp(grid.bounds, axis=1)
    widths = [float(np.max(sides / store.shape(k))) for k in range(store.levels)]
    # Rounding must not decide where a cell is as wide as a pixel.
    return max((k for k, cell in enumerate(widths) if cell <= width * (1 + 1e-6)), default=0)


def _pixel_sizes(camera: Camera, frame: Frame) -> tuple[float, float, np.ndarray]:
    """Return the width of pixels where rays begin, its growth per length, and where they begin.

    Of parallel rays it is the shorter side of a pixel; of others, the longer one as seen by the
    narrowest of some pixels. The last is the least and the largest origin, shape (2, 3).
    """
    backend = get_backend("cpu", "double")
    vectors = frame.traced_vectors(backend)
    x, y = frame.coordinates()
    some = [values[np.linspace(0, len(values) - 1, _PROBES).astype(int)] for values in (x, y)]
    u, v = (places.ravel() for places in np.meshgrid(*some))

    def rays(du: float, dv: float) -> tuple[np.ndarray, np.ndarray]:
        ray = camera.rays(vectors, *(from_host(backend.Wide, p) for p in (u + du, v + dv)))
        origin, direction = (
            np.stack([np.broadcast_to(np.asarray(c), u.shape) for c in part], axis=-1)
            for part in (ray.origin, ray.direction)
        )
        return origin, direction

    (origin, direction), *beside = (
        rays(*step) for step in ((0.0, 0.0), (frame.pixel[0], 0.0), (0.0, frame.pixel[1]))
    )
    apart, spread = (
        [np.linalg.norm(other[k] - own, axis=-1) for other in beside]
        for k, own in enumerate((origin, direction))
    )
    ends = np.stack([origin.min(axis=0), origin.max(axis=0)])
    if camera.parallel:
        return float(np.min(apart)), 0.0, ends
    return 0.0, float(np.min(np.maximum(*spread))), ends


def _visible_boxes(volume: Volume, medium: Medium) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and the upper corners of what may be visible, shape (n, 3)."""
    store, grid = volume.store, volume.grid
    whole = grid.bounds.T
    tables = {}
    for name in medium.names:
        table = store.extremes(name) if name in volume.fields else None
        if table is None or np.isnan(table).any():
            return whole[:1], whole[1:]
        tables[name] = Interval(*np.moveaxis(table.astype(np.float64), -1, 0))
    if len({table.lo.shape for table in tables.values()}) != 1:
        return whole[:1], whole[1:]
    plain = calibrated(medium, volume, Cache(volume).measurements)
    bound = plain.bind(Binding.to(volume))
    with np.errstate(all="ignore"):
        seen = np.asarray(bound.may_show(tables, RangeContext()))
    place = np.argwhere(np.broadcast_to(seen, next(iter(tables.values())).lo.shape))
    low = place * store.chunks
    high = np.minimum(low + store.chunks, grid.shape)
    corner = functools.partial(np.stack, axis=-1)
    return (
        corner([edges[i] for edges, i in zip(grid.edges, low.T, strict=True)]),
        corner([edges[i] for edges, i in zip(grid.edges, high.T, strict=True)]),
    )
