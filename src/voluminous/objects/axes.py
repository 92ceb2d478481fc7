"""Axes of a volume, as lines."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .contract import Layers, SceneObject
from .lines import Lines
from .values import merged, options_of
from .view import View

# How much nearer than it is an axis is drawn, as a fraction of the volume's diagonal.
_NEARER = 1e-6


class Axes(SceneObject):
    """Lines along x, y and z; see `axes`."""

    def __init__(
        self, grid: Any, origin: Any, length: Any, colors: Any, width: Any, **options: Any
    ) -> None:
        super().__init__(**options)
        self.grid, self.colors, self.width = grid, colors, width
        self.origin, self.length = merged(origin), merged(length)
        self.style = {"width": width, **options}

    def layers(self, view: View) -> Layers | None:
        grid = view.grid if self.grid is None else self.grid
        start, ends = grid.bounds[:, 0], grid.bounds[:, 1]
        if self.origin is not None:
            start = np.asarray(view.length(self.origin, "origin"))
        lengths = ends - start if self.length is None else view.length(self.length, "length")
        lines = [np.stack([start, start + way]) for way in np.broadcast_to(lengths, 3) * np.eye(3)]
        colors = self.colors
        if colors is None:
            colored = view.channels == 3 and self.channel is None
            colors = ("red", "lime", "blue") if colored else 1.0
        found = Lines(lines, colors, **self.style).layers(view)
        if found is not None:  # edges of boxes in the same place are behind
            found.depth -= _NEARER * float(np.linalg.norm(ends - grid.bounds[:, 0]))
        return found

    def describe(self, most: float = math.inf) -> dict[str, Any]:
        return {"type": "axes", **options_of(axes, self, most)}


def axes(
    volume: Any = None,
    colors: Any = None,
    *,
    origin: Any = None,
    length: Any = None,
    width: Any = 2.0,
    depth: str = "true",
    channel: int | None = None,
    relative: bool = True,
) -> Axes:
    """Return lines along x, y and z.

    Parameters
    ----------
    volume : Volume, optional
        Default: the one that is rendered.
    colors : optional
        As for `Lines`, for three lines. Default: red, green and blue where there are three
        channels, else white.
    origin : three floats or Quantity, optional
        Where they begin; default: the lower corner of the box around the volume.
    length : float, Quantity or three of them, optional
        Default: to the upper ends of that box.
    width, depth, channel
        As for `Lines`.
    relative : bool
        Colours count in units of the picture's brightest pixel.
    """
    grid = None if volume is None else volume.grid
    options: dict[str, Any] = {"depth": depth, "channel": channel, "relative": relative}
    return Axes(grid, origin, length, colors, width, **options)
