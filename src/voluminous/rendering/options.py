"""Validation of the arguments of render(), and their conversion to one form."""

from __future__ import annotations

import logging
import math
import numbers
from collections.abc import Iterable
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any

import numpy as np

from ..backend import Backend
from ..cameras.contract import Camera, Frame
from ..colormaps import get_color, without_alpha
from ..errors import InputError, check_name
from ..geometry import many_valued
from ..grids.cartesian.grid import CartesianGrid
from ..grids.contract import DualGrid, Grid, VertexGrid
from ..media.contract import Medium
from ..memory import check_memory
from ..progress import Progress
from ..schemes.base import Scheme
from ..units import as_quantity, is_quantity

ANTIALIAS = ("adaptive", "radmc3d")
# Error of the default cut-off, as a fraction of the intensity that the ray has gathered.
DEFAULT_ERROR = 1e-4
# The finest tolerance that single precision reaches: rounding is 3e-6 of the sum of all colours.
FINEST_SINGLE = 1e-5
_MOST_SAMPLES = 4096
# Pixels are counted in 32 bits, in tiles that may extend beyond the edge.
_MOST_PIXELS = 1 << 31
# Numbers stored per pixel besides those of channels: errors and order.
_OTHER_PLANES = 6
# Tolerance for skipping faint places where none is requested.
_CARELESS = 0.1


@dataclass(frozen=True)
class RenderOptions:
    """The options of `render`, by its names: how a scene is drawn."""

    view: str | None = None
    objects: Any = ()
    background: Any = 0.0
    clip: Any = None
    scheme: Any = None
    tolerance: float | None = 1e-3
    precision: str = "single"
    cutoff: float | None = None
    bounds: bool = False
    max_panels: int = 1024
    samples: int = 1
    antialias: str | None = None
    memory: Any = None
    executor: Any = None
    checkpoint: Any = None
    level: Any = None
    device: str = "auto"
    progress: Progress = None


def check_options(options: Iterable[str]) -> None:
    """Refuse options of other functions that `render` does not have."""
    for name in options:
        check_name("option", name, [field.name for field in fields(RenderOptions)])


def check_pixels(pixels: tuple[int, int], medium: Medium, backend: Backend) -> None:
    """Refuse a picture that does not fit into memory."""
    count = int(pixels[0]) * int(pixels[1])
    size = f"a picture of {pixels[0]} x {pixels[1]} pixels"
    if count > _MOST_PIXELS:
        raise InputError(f"{size} is too large: {_MOST_PIXELS} pixels are the most there can be")
    # Emission of every channel, transparency and depth of each extinction, on the device and in
    # the image: 40 channels of 1500 x 1500 pixels were 2.6 GB.
    planes = 4 * medium.channels + 6 * (1 if medium.grey else medium.channels)
    needed = count * backend.dtype.itemsize * (planes + _OTHER_PLANES)
    check_memory(needed, size, "lower the resolution, or draw it in parts")


def check_cutoff(cutoff: Any) -> float | None:
    """Return the transparency at which rays stop; None for the default criterion."""
    if cutoff is None:
        return None
    real = isinstance(cutoff, Real)
    if not real or not 0 <= cutoff < 1:
        raise InputError(
            f"cutoff is the transparency at which a ray stops: at least 0 (never) and below 1, "
            f"got {cutoff!r}"
        )
    return float(cutoff)


def refuse_unusable(precision: str) -> None:
    """Raise the error for results that are not finite."""
    raise InputError(
        "the picture is not finite: the medium gives coefficients that are not, or too large "
        f"for {precision} precision, or a negative extinction, in cells that rays "
        "visit; scheme='first-order' names the first of them, and `volume.evaluate(...)` shows "
        "fields and expressions"
    )


def check_tolerance(tolerance: Any) -> float:
    """Return the error allowed, relative to the brightest pixel."""
    if tolerance is None:
        return _CARELESS
    real = isinstance(tolerance, Real)
    if not real or not 1e-9 <= tolerance <= 1:
        raise InputError(
            "tolerance is the error allowed in a pixel, as a fraction of the brightest: from 1e-9 "
            f"to 1, or None (do not look), got {tolerance!r}"
        )
    return float(tolerance)


def check_antialias(samples: Any, antialias: Any, camera: Camera) -> None:
    """Refuse an invalid number of rays or antialiasing method."""
    whole = isinstance(samples, numbers.Integral) and not isinstance(samples, bool)
    if not whole or not 1 <= samples <= _MOST_SAMPLES:
        raise InputError(
            "samples must be a whole number n (n x n rays per pixel); antialias='adaptive' takes "
            f"more rays where the picture is not smooth; got {samples!r}"
        )
    if antialias is None:
        return
    check_name("antialias", antialias, ANTIALIAS)
    if samples != 1:
        raise InputError(f"give samples={samples!r} or antialias={antialias!r}, not both")
    if antialias == "radmc3d" and not camera.parallel:
        raise InputError(
            "antialias='radmc3d' compares pixels with cells: it needs parallel rays "
            "(vm.Orthographic); use antialias='adaptive'"
        )


def sample_count(samples: int, antialias: str | None, frame: Frame, grid: Any) -> int:
    """Return n for n × n rays per pixel.

    RADMC-3D quarters a pixel while its longer side exceeds the width of the narrowest cell on its
    ray: 2^k × 2^k regular parts, where all cells count as equally wide. Otherwise n is 1, and
    `flux_conserving` divides the pixels.
    """
    if antialias != "radmc3d" or not isinstance(grid, CartesianGrid):
        return int(samples)
    ratio = max(frame.pixel) / grid.first_cell_width()
    count: int = 1 << math.ceil(math.log2(max(ratio, 1.0)))
    if count > _MOST_SAMPLES:
        raise InputError(
            f"flux conservation needs {count} x {count} rays per pixel here (a pixel is "
            f"{ratio:.3g} cells wide): take more pixels, or a smaller width"
        )
    return count


def check_walk(scheme: Scheme, grid: Grid) -> None:
    """Refuse a scheme that a grid has no walk for."""
    where = scheme.coefficients_at
    if (where == "field" and not isinstance(grid, DualGrid)) or (
        where == "vertex" and not isinstance(grid, VertexGrid)
    ):
        raise InputError(
            f"scheme {scheme.name!r} cannot be used on a {type(grid).__name__}; "
            "use scheme='first-order'"
        )


def check_coordinates(scheme: Scheme, grid: Grid, names: Iterable[str]) -> None:
    """Refuse coordinates that vary within cells, for schemes that treat cells as wholes."""
    for name in names if scheme.coefficients_at != "field" else ():
        if name in many_valued(grid):
            mirrored = grid.mirror and name == "z"
            many = "volume.unfolded()" if mirrored else "volume.unfolded(phi=64)"
            raise InputError(
                f"{name!r} differs within a cell of this grid, which scheme {scheme.name!r} takes "
                "as a whole: use scheme='post-classified', which knows where on its way a ray is, "
                f"or {many}, in which every cell is in one place"
            )


def background_array(background: Any, pixels: tuple[int, int], channels: int) -> np.ndarray:
    """Return the background as an array that broadcasts to (ny, nx, channel)."""
    given = as_quantity(getattr(background, "intensity", background))
    if channels == 3 and isinstance(given, str):
        given = get_color(given)
    if is_quantity(given):  # NumPy would drop the unit
        raise InputError(
            f"background must be plain numbers, in the unit of the image's intensity, got {given}"
        )
    if channels == 3 and isinstance(given, (list, tuple, np.ndarray)) and len(given) == 4:
        given = without_alpha(given, "background")
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"background must be numbers or an image, got {background!r}") from error
    nx, ny = pixels
    shapes = ((), (1,), (channels,), (ny, nx), (ny, nx, 1), (ny, nx, channels))
    if array.shape not in shapes:
        raise InputError(
            f"background must be a number, {channels} numbers (one per channel), or an image of "
            f"shape ({ny}, {nx}) or ({ny}, {nx}, {channels}); got shape {array.shape}"
        )
    if not np.all(np.isfinite(array)):
        raise InputError("background must be finite")
    return array[..., None] if array.shape == (ny, nx) else array


# A picture that takes more seconds names the choices that make it slow, once per process; times are
# relative to the defaults.
_LONG = 5.0
_SLOW = {
    "adaptive": "antialias='adaptive' takes 16 to 256 rays where the picture is not smooth, 10 to "
    "30 times as long as one ray per pixel; samples=4 takes 16 rays",
    "bounds": "bounds=True takes about 60 times as long; image.error is an estimate without it",
    "tolerance": "a tolerance below 1e-5 takes double precision, 5 to 20 times as long as 1e-3",
    "double": "precision='double' takes 2 to 5 times as long as 'single'",
}
_named: set[str] = set()


def name_slow_choices(seconds: float, named: set[str] = _named, **chosen: bool) -> None:
    """Log a warning if a picture took long."""
    slow = [name for name in _SLOW if chosen.get(name) and name not in named]
    if seconds > _LONG and slow:
        named.update(slow)
        advice = "; ".join(_SLOW[name] for name in slow)
        logging.getLogger("voluminous").warning("%.0f s for a picture: %s", seconds, advice)
