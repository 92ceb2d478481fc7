"""What an object in a picture promises: layers that cover pixels, and points that carry a flux."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, check_name
from ..value import Value
from .values import MANY, options_of

if TYPE_CHECKING:
    from .view import View

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
class Points:
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

    def lights(self, view: View) -> Points | None:
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
