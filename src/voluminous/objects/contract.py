"""What an object in a picture promises: layers that cover pixels, and points that carry a flux."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..backend import from_host
from ..colormaps import without_alpha
from ..errors import InputError, check_name
from ..grids.arguments import on_grid
from ..units import as_quantity, described, plain
from ..value import Value
from .values import MANY, count_of, is_named, is_spectrum, named_rgb

if TYPE_CHECKING:
    from astropy import units as u

    from ..backend import Backend
    from ..cameras import Camera, Frame
    from ..grids.contract import Grid

DEPTHS = ("true", "foreground")
# A Gaussian is cut off here, in standard deviations; what is left of it is normalised.
REACH = 4.0
# Step of differences, as a fraction of the distance: its square and rounding over it are small.
_STEP = 1e-4


class Layers(NamedTuple):
    """Pairs (b, θ) that lie across the rays of pixels, each at its depth.

    `pixel` (n,) are flat numbers of pixels, row by row; `depth` (n,) distances along the pixel's
    ray in the volume's unit; `emission` (n, channel) b, what a layer adds to a pixel's intensity if
    nothing is in front; `opacity` (n,) 1 - θ, the part of a pixel in which it hides what is behind.
    """

    pixel: np.ndarray
    depth: np.ndarray
    emission: np.ndarray
    opacity: np.ndarray

    @classmethod
    def joined(cls, parts: list[Layers], channels: int) -> Layers:
        """Return all layers of several objects."""
        if len(parts) == 1:
            return parts[0]
        empty = np.empty(0)
        none = cls(np.empty(0, np.int64), empty, np.empty((0, channels)), empty)
        return cls(*map(np.concatenate, zip(none, *parts, strict=True)))

    def some(self, index: np.ndarray) -> Layers:
        """Return those of some numbers."""
        return Layers(*(part.take(index, axis=0) for part in self))


class PointLights(NamedTuple):
    """Points of light: smaller than a pixel.

    `x` and `y` (n,) are in pixels, the middle of the first one is at 0; `depth` (n,) is as of
    `Layers`; `flux` (n, channel) is what they add to the sum of all pixels, if nothing is in front;
    `sigma` (2,) are the widths in pixels of the Gaussian that they are spread over, along x and y;
    `opacity` (n,) the part of its pixel in which each hides what is behind.
    """

    x: np.ndarray
    y: np.ndarray
    depth: np.ndarray
    flux: np.ndarray
    sigma: np.ndarray
    opacity: np.ndarray


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

    def intensities(
        self, colors: Any, count: int, view: View, unit: u.UnitBase | None
    ) -> np.ndarray:
        """Return the intensities of `count` things in all channels, shape (count, all), in `unit`.

        Colours are a name, a number, one per channel; or a list of `count` of them.
        """
        channels = view.channels if self.channel is None else 1
        if is_spectrum(colors):
            raise InputError(
                "colors that are spectra need frequencies: vm.observe(volume, medium, camera, "
                "wavelengths=…, objects=…)"
            )
        if is_named(colors):
            if view.channels != 3 or self.channel is not None:
                place = "one" if self.channel is not None else view.channels
                raise InputError(
                    f"colors: names are red, green and blue; in {place} channel(s) give numbers"
                )
            array = named_rgb(colors, count, "colors")
        else:
            colors = colors if channels == 4 else without_alpha(colors, "colors")
            array = np.asarray(plain(colors, unit, "colors"), dtype=np.float64)
        array = array if array.ndim else np.full(channels, float(array))
        if array.shape[-1] not in (1, channels):
            raise InputError(
                f"colors: expected a number, or {channels} (one per channel), or a list of {count} "
                f"of these, of shape ({count}, 1) or ({count}, {channels}); got shape {array.shape}"
            )
        first, result = self.channel or 0, np.zeros((count, view.all_channels))
        result[:, first : first + channels] = array * (view.brightest if self.relative else 1.0)
        return result

    def describe(self, most: float = math.inf) -> dict[str, Any]:
        """Return type and arguments as plain values: what a scene file says of it.

        Parameters
        ----------
        most : float
            Arguments of more numbers than these are only counted.
        """
        parameters = inspect.signature(type(self)).parameters
        result: dict[str, Any] = {"type": type(self).__name__.lower()}
        for name, given in self.arguments().items():
            value, default = as_quantity(given), parameters[name].default
            single = not isinstance(value, (list, tuple)) and np.ndim(value) == 0
            same = value is default or (single and bool(np.all(value == default)))
            if name != "volume" and not same:  # in a scene file there is but one volume
                count = count_of(value)
                result[name] = described(value) if count <= most else f"{count} values"
        return result

    def __repr__(self) -> str:
        arguments = [f"{k}={v!r}" for k, v in self.describe(MANY).items() if k != "type"]
        return f"{type(self).__name__}({', '.join(arguments)})"


@dataclass
class View:
    """What objects need to know of a picture.

    The medium's channels come first in it; `picture` gives its brightest pixel without objects.
    """

    camera: Camera
    grid: Grid
    frame: Frame
    backend: Backend
    channels: int
    all_channels: int
    intensity_unit: u.UnitBase | None
    picture: Callable[[], float]

    @functools.cached_property
    def brightest(self) -> float:
        """The brightest pixel without objects; 1 if all are black."""
        return self.picture() or 1.0

    def length(self, value: Any, what: str) -> Any:
        """Return lengths in the volume's unit."""
        return on_grid(value, self.grid, what)

    def place(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x and y in pixels and the depth of points (n, 3); NaN where they are not seen."""
        *plane, depth = self.camera.project(np.ascontiguousarray(points.T), self.grid)
        frame = self.frame
        x, y = (
            (w - shift) / step + 0.5 * (n - 1)
            for w, shift, step, n in zip(plane, frame.shift, frame.pixel, frame.pixels, strict=True)
        )
        return x, y, depth

    def directions(self, points: np.ndarray) -> np.ndarray:
        """Return unit vectors from the observer to points (n, 3)."""
        directions: np.ndarray = np.asarray(self.camera.lines_of_sight(points.T, self.grid)).T
        return directions

    def rays(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return origins and directions (n, 3) of the rays through places in pixels."""
        if not len(x):
            return np.empty((0, 3)), np.empty((0, 3))
        ray = self.traced_rays(x, y)
        origin, direction = (
            np.stack([np.broadcast_to(np.asarray(p), x.shape) for p in parts]).T
            for parts in (ray.origin, ray.direction)
        )
        return origin, direction

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
        zero = np.zeros(1)
        return None if self.camera.parallel else np.asarray(self.rays(zero, zero)[0][0])

    @functools.cached_property
    def axis(self) -> np.ndarray:
        """Direction of the ray through the middle of the picture."""
        middle = [np.array([0.5 * (n - 1)]) for n in self.frame.pixels]
        return np.asarray(self.rays(*middle)[1][0])

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
        step = _STEP * self.place(points)[2][:, None]
        sides = []
        for e in self.across(self.directions(points)):
            ahead, back = self.place(points + step * e), self.place(points - step * e)
            sides.append([(a - b) / (2.0 * step[:, 0]) for a, b in zip(ahead, back, strict=True)])
        (ax, ay, _), (bx, by, _) = sides
        return np.asarray(np.abs(ax * by - ay * bx))


def numbered(count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return 0 … n, each as often as `count` says, and the number of each among its equals."""
    owner = np.repeat(np.arange(len(count)), count)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)


def window_pixels(
    x: np.ndarray, y: np.ndarray, pixels: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which thing, x and y of all pixels of a picture that touch windows, shape (k,) each.

    `x` and `y` (2, n) are the edges of windows in pixels; the middle of the first pixel is at 0.
    Where one is NaN there is no window.
    """
    first, size = [], []
    for edges, count in zip((x, y), pixels, strict=True):
        valid = np.isfinite(edges).all(axis=0)
        nearest = np.floor(np.where(valid, edges, 0.0) + 0.5)
        low, high = np.clip(nearest, -1, count).astype(np.int64)
        low, high = np.maximum(low, 0), np.minimum(high, count - 1)
        first.append(low)
        size.append(np.where(valid, np.maximum(high - low + 1, 0), 0))
    owner, number = numbered(size[0] * size[1])
    row, column = np.divmod(number, np.maximum(size[0][owner], 1))
    return owner, first[0][owner] + column, first[1][owner] + row
