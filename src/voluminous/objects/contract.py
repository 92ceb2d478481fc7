"""What an object in a picture promises: layers that cover pixels, and points that carry a flux."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import from_host
from ..colormaps import without_alpha
from ..errors import InputError, check_name
from ..units import plain
from ..value import Value
from .values import MANY, is_named, named_rgb, options_of

if TYPE_CHECKING:
    from ..backend import Backend
    from ..cameras import Camera, Frame
    from ..grids.contract import Grid

DEPTHS = ("true", "foreground")
# A Gaussian is cut off here, in standard deviations; what is left of it is normalised.
REACH = 4.0


@dataclass
class Layers:
    """Pairs (b, θ) that lie across the rays of pixels, each at its depth.

    Attributes
    ----------
    pixel : int array, shape (n,)
        Flat numbers of pixels, row by row.
    depth : float64 array, shape (n,)
        Distance along the pixel's ray from its origin, in the volume's unit.
    emission : float64 array, shape (n, channel)
        b: what it adds to a pixel's intensity, if nothing is in front.
    opacity : float64 array, shape (n,)
        1 - θ: the part of a pixel in which it hides what is behind.
    """

    pixel: np.ndarray
    depth: np.ndarray
    emission: np.ndarray
    opacity: np.ndarray

    @classmethod
    def of(
        cls, pixel: np.ndarray, depth: np.ndarray, coverage: np.ndarray, color: Any, opacity: Any
    ) -> Layers:
        """Return layers of some colour and opacity that cover a fraction of each pixel."""
        return cls(pixel, depth, coverage[:, None] * color, coverage * opacity)

    @classmethod
    def none(cls, channels: int) -> Layers:
        """Return no layers."""
        empty = np.empty(0)
        return cls(np.empty(0, np.int64), empty, np.empty((0, channels)), empty)

    @classmethod
    def joined(cls, parts: list[Layers], channels: int) -> Layers:
        """Return all layers of several objects."""
        parts = parts or [cls.none(channels)]
        if len(parts) == 1:
            return parts[0]
        names = ("pixel", "depth", "emission", "opacity")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def some(self, index: np.ndarray) -> Layers:
        """Return those of some numbers."""
        parts = (self.pixel, self.depth, self.emission, self.opacity)
        return Layers(*(part.take(index, axis=0) for part in parts))


@dataclass
class PointLights:
    """Points of light: too small to hide anything.

    Attributes
    ----------
    x, y : float64 arrays, shape (n,)
        In pixels; the middle of the first one is at 0.
    depth : float64 array, shape (n,)
        As of `Layers`.
    flux : float64 array, shape (n, channel)
        What they add to the sum of all pixels, if nothing is in front.
    sigma : float64 array, shape (2,)
        Widths of the Gaussian that they are spread over, along x and y, in pixels.
    """

    x: np.ndarray
    y: np.ndarray
    depth: np.ndarray
    flux: np.ndarray
    sigma: np.ndarray


class SceneObject(Value):
    """Something that is drawn into a picture.

    Parameters
    ----------
    depth : {"true", "foreground"}
        Where it is: what is in front dims it and it hides what is behind; or in front of all.
    channel : int, optional
        The only channel in which it shines. It may be the one behind the medium's last, and so on:
        the picture then gets it. Default: all of the medium's.
    relative : bool
        Colours count in units of the brightest pixel of the picture without objects.

    Raises
    ------
    InputError
        If an argument cannot be used.
    UnknownNameError
        For another depth.
    """

    def __init__(
        self, *, depth: str = "true", channel: int | None = None, relative: bool = False
    ) -> None:
        check_name("depth", depth, DEPTHS)
        whole = isinstance(channel, (int, np.integer)) and not isinstance(channel, bool)
        if channel is not None and (not whole or channel < 0):
            raise InputError(f"channel must be a whole number, the first is 0; got {channel!r}")
        self.depth, self.channel, self.relative = depth, channel, relative

    def layers(self, view: View) -> Layers | None:
        """Return the layers that are in view."""
        return None

    def lights(self, view: View) -> PointLights | None:
        """Return the points of light that are in view."""
        return None

    def describe(self, most: float = math.inf) -> dict[str, Any]:
        """Return type and arguments as plain values: what a scene file says of it.

        Parameters
        ----------
        most : float
            Arguments of more numbers than these are only counted.
        """
        return {"type": type(self).__name__.lower(), **options_of(type(self), self, most)}

    def __repr__(self) -> str:
        told = ", ".join(f"{k}={v!r}" for k, v in self.describe(MANY).items() if k != "type")
        return f"{type(self).__name__}({told})"


# Step of differences, as a fraction of the distance: its square and rounding over it are small.
_STEP = 1e-4


@dataclass
class View:
    """What objects need to know of a picture.

    Attributes
    ----------
    camera, grid, frame, backend : object
    channels : int
        Those of the medium, which come first.
    all_channels : int
        Those of the picture.
    intensity_unit : astropy unit or None
    picture : callable
        Gives the brightest pixel without objects.
    """

    camera: Camera
    grid: Grid
    frame: Frame
    backend: Backend
    channels: int
    all_channels: int
    intensity_unit: Any
    picture: Callable[[], float]

    @functools.cached_property
    def brightest(self) -> float:
        """The brightest pixel without objects; 1 if all are black."""
        return self.picture() or 1.0

    def length(self, value: Any, what: str) -> Any:
        """Return lengths in the volume's unit."""
        return plain(value, self.grid.unit, what)

    def place(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x and y in pixels and the depth of points (n, 3); NaN where they are not seen."""
        u, v, depth = self.camera.project(np.ascontiguousarray(points.T), self.grid)
        x, y = (
            (w - shift) / step + 0.5 * (n - 1)
            for w, shift, step, n in zip(
                (u, v), self.frame.shift, self.frame.pixel, self.frame.pixels, strict=True
            )
        )
        return x, y, depth

    def directions(self, points: np.ndarray) -> np.ndarray:
        """Return unit vectors from the observer to points (n, 3)."""
        return np.asarray(self.camera.lines_of_sight(points.T, self.grid)).T

    def rays(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return origins and directions (n, 3) of the rays through places in pixels."""
        if not len(x):
            return np.empty((0, 3)), np.empty((0, 3))
        ray = self.traced_rays(x, y)

        def stacked(parts: Any) -> np.ndarray:
            return np.stack([np.broadcast_to(np.asarray(p), x.shape) for p in parts]).T

        return stacked(ray.origin), stacked(ray.direction)

    def traced_rays(self, x: np.ndarray, y: np.ndarray) -> Any:
        """Return the rays through places in pixels as kernels see them."""
        backend, frame = self.backend, self.frame
        u, v = (
            from_host(backend.Wide, (w - 0.5 * (n - 1)) * step + shift)
            for w, shift, step, n in zip(
                (x, y), frame.shift, frame.pixel, frame.pixels, strict=True
            )
        )
        return self.camera.rays(frame.traced_vectors(backend), u, v)

    @functools.cached_property
    def observer(self) -> np.ndarray | None:
        """Where all rays begin; None at infinity."""
        return None if self.camera.parallel else self.rays(*np.zeros((2, 1)))[0][0]

    @functools.cached_property
    def axis(self) -> np.ndarray:
        """Direction of the ray through the middle of the picture."""
        middle = [np.array([0.5 * (n - 1)]) for n in self.frame.pixels]
        return self.rays(*middle)[1][0]

    def across(self, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return two unit vectors normal to directions (n, 3) and to each other.

        The first one points to the picture's middle: the image of a sphere in a flat or round
        perspective is symmetric about that line.
        """
        inward = self.axis - (direction @ self.axis)[:, None] * direction
        # In the middle any will do: the one along the axis that is farthest from the direction.
        other = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
        other = other - np.sum(other * direction, axis=1, keepdims=True) * direction
        size = np.linalg.norm(inward, axis=1, keepdims=True)
        inward = np.where(size > 1e-9, inward, other)
        inward = inward / np.linalg.norm(inward, axis=1, keepdims=True)
        return inward, np.cross(direction, inward)

    def pixels_per_area(self, points: np.ndarray) -> np.ndarray:
        """Return how many pixels an area of one, facing the observer at points (n, 3), fills."""
        dx, dy = self.frame.pixel
        if self.camera.parallel:
            return np.full(len(points), 1.0 / abs(dx * dy))
        direction = self.directions(points)
        step = _STEP * self.place(points)[2][:, None]
        sides = []
        for e in self.across(direction):
            ahead, back = self.place(points + step * e), self.place(points - step * e)
            sides.append([(a - b) / (2.0 * step[:, 0]) for a, b in zip(ahead, back, strict=True)])
        (ax, ay, _), (bx, by, _) = sides
        return np.abs(ax * by - ay * bx)


def window_pixels(
    left: np.ndarray,
    right: np.ndarray,
    bottom: np.ndarray,
    top: np.ndarray,
    pixels: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which thing, x and y of all pixels that touch windows, shape (k,) each.

    Parameters
    ----------
    left, right, bottom, top : float arrays, shape (n,)
        Edges in pixels; the middle of the first pixel is at 0. Where one is NaN there is none.
    pixels : (int, int)
        Size of the picture: what is outside is left out.
    """
    nx, ny = pixels
    x0, columns = _range(left, right, nx)
    y0, rows = _range(bottom, top, ny)
    count = columns * rows
    owner = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(number, np.maximum(columns[owner], 1))
    return owner, x0[owner] + column, y0[owner] + row


def _range(low: np.ndarray, high: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    seen = np.isfinite(low) & np.isfinite(high)
    first, last = (
        np.clip(np.floor(np.where(seen, edge, 0.0) + 0.5), -1, count).astype(np.int64)
        for edge in (low, high)
    )
    first, last = np.maximum(first, 0), np.minimum(last, count - 1)
    return first, np.where(seen, np.maximum(last - first + 1, 0), 0)


def intensities(thing: SceneObject, colors: Any, count: int, view: View, unit: Any) -> np.ndarray:
    """Return the intensities of `count` things in all channels of a picture, shape (count, all).

    Parameters
    ----------
    colors : str, float, Quantity or array_like
        A name, a number, one per channel; or a list of `count` of them.
    unit : astropy unit or None
        What they are to be expressed in.
    """
    own = view.channels if thing.channel is None else 1
    if is_named(colors):
        if view.channels != 3 or thing.channel is not None:
            place = "one channel" if thing.channel is not None else f"{view.channels} channel(s)"
            raise InputError(f"colors: names are red, green and blue; in {place} give numbers")
        array = named_rgb(colors, count, "colors")
    else:
        colors = colors if own == 4 else without_alpha(colors, "colors")
        array = np.asarray(plain(colors, unit, "colors"), dtype=np.float64)
    array = array if array.ndim else np.full(own, float(array))
    if array.shape[-1] not in (1, own):
        raise InputError(
            f"colors: expected a number, or {own} (one per channel), or a list of {count} of "
            f"these, of shape ({count}, 1) or ({count}, {own}); got shape {array.shape}"
        )
    first = 0 if thing.channel is None else thing.channel
    found = np.zeros((count, view.all_channels))
    found[:, first : first + own] = array * (view.brightest if thing.relative else 1.0)
    return found
