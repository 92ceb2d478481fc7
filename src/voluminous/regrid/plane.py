"""A plane through a grid: which cell is where on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError, unknown_name
from ..memory import check_memory
from ..units import is_count, plain, shown, unit_name

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_VECTOR = "three finite numbers"
# What is counted, pixels and points, is less than this.
MOST = 1 << 31
# Per pixel, while its cell is looked for: places in space, in the grid, in whole numbers.
_PIXEL_BYTES = 210
# What is to the right and up in a slice across an axis: the next axes in turn.
_FRAMES = {"x": ("y", "z"), "y": ("z", "x"), "z": ("x", "y")}


@dataclass(frozen=True)
class Plane:
    """A rectangle in space, with pixels.

    Attributes
    ----------
    center, right, up : arrays, shape (3,)
        Its middle, and unit vectors along its sides.
    width : (float, float)
    pixels : (int, int)
    """

    center: np.ndarray
    right: np.ndarray
    up: np.ndarray
    width: tuple[float, float]
    pixels: tuple[int, int]

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Coordinates of the sides along `right` and `up`: left, right, bottom, top."""
        u, v = float(self.center @ self.right), float(self.center @ self.up)
        w, h = self.width
        return u - 0.5 * w, u + 0.5 * w, v - 0.5 * h, v + 0.5 * h

    def points(self) -> np.ndarray:
        """Return the middles of the pixels, shape (ny * nx, 3), row 0 at the bottom."""
        steps = [
            ((np.arange(n) + 0.5) / n - 0.5) * w
            for n, w in zip(self.pixels, self.width, strict=True)
        ]
        v, u = np.meshgrid(steps[1], steps[0], indexing="ij")
        return np.asarray(self.center + u.reshape(-1, 1) * self.right + v.reshape(-1, 1) * self.up)


def make_plane(
    grid: Any, normal: Any, position: Any, width: Any, center: Any, up: Any, resolution: Any
) -> Plane:
    """Return a plane through a grid; see `Volume.slice`."""
    towards, right, upwards = _frame(normal, up)
    middle = grid.bounds.mean(axis=1) if center is None else _three(center, grid.unit, "center")
    if position is not None:
        middle = middle + (_finite(position, grid.unit, "position") - middle @ towards) * towards
    size = _size(grid, width, middle, right, upwards)
    return Plane(middle, right, upwards, size, _pixels(resolution, size))


def cells_on(grid: Any, plane: Plane) -> np.ndarray:
    """Return the flat numbers of the cells at a plane's pixels, shape (ny, nx); -1 outside.

    Raises
    ------
    InputError
        If no pixel is in a cell: what would be shown is nothing.
    MemoryNeededError
        If there are more pixels than fit.
    """
    nx, ny = plane.pixels
    check_memory(
        _PIXEL_BYTES * nx * ny, f"a slice of {nx} x {ny} pixels", "take fewer, resolution=400"
    )
    points = plane.points()
    cells = np.asarray(grid.locate(points)).reshape(ny, nx)
    if cells.max() < 0:
        low, high = grid.bounds.T
        inside = np.all((points >= low) & (points <= high), axis=1).any()
        why = "where the slice is the grid has a gap" if inside else "the slice is outside of it"
        raise InputError(
            f"no pixel of the slice is in a cell; the volume is in {_told(grid)}: {why}; give "
            "another position= or center="
        )
    return cells


def _told(grid: Any) -> str:
    spans = zip("xyz", grid.bounds, strict=True)
    listed = ", ".join(f"{axis}: {low:g} … {high:g}" for axis, (low, high) in spans)
    return f"{listed} {unit_name(grid.unit)}".rstrip()


def _frame(normal: Any, up: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    if isinstance(normal, str):
        if normal not in AXES:
            raise unknown_name("axis", normal, AXES)
        if up is None:
            return _along(normal), _along(_FRAMES[normal][0]), _along(_FRAMES[normal][1])
        normal = AXES[normal]
    towards = _unit(normal, "normal", f"'x', 'y', 'z' or {_VECTOR}")
    if up is None:
        up = AXES["z"] if abs(towards[2]) < 1 - 1e-9 else AXES["y"]
    sideways = np.cross(_unit(up, "up"), towards)
    if np.linalg.norm(sideways) < 1e-9:
        raise InputError(f"up must not be parallel to the normal, got {up!r}")
    sideways /= np.linalg.norm(sideways)
    return towards, sideways, np.cross(towards, sideways)


def _along(axis: str) -> np.ndarray:
    return np.array(AXES[axis])


def _size(
    grid: Any, width: Any, middle: np.ndarray, right: np.ndarray, up: np.ndarray
) -> tuple[float, float]:
    if width is None:
        corners = np.array(np.meshgrid(*grid.bounds, indexing="ij")).reshape(3, -1).T - middle
        return 2 * float(np.abs(corners @ right).max()), 2 * float(np.abs(corners @ up).max())
    size = np.asarray(plain(width, grid.unit, "width"))
    if size.shape not in ((), (2,)) or not np.all(np.isfinite(size)) or size.min() <= 0:
        raise InputError(f"width must be a positive number or a pair of them, got {width!r}")
    w, h = np.broadcast_to(size, (2,)).tolist()
    return w, h


def _pixels(resolution: Any, size: tuple[float, float]) -> tuple[int, int]:
    """Return (nx, ny): a pair as it is, a number for the longer side, with square pixels."""
    pair = resolution if isinstance(resolution, (list, tuple)) else np.atleast_1d(resolution)
    if len(pair) not in (1, 2) or not all(is_count(n, MOST) for n in pair):
        raise InputError(
            f"resolution must be a positive whole number or a pair, got {shown(resolution)}"
        )
    if len(pair) == 2:
        return int(pair[0]), int(pair[1])
    longest = max(size)
    nx, ny = (max(1, round(int(pair[0]) * w / longest)) for w in size)
    return nx, ny


def _finite(value: Any, unit: Any, what: str) -> float:
    number = None if value is None else plain(value, unit, what)
    if not isinstance(number, float) or not np.isfinite(number):
        raise InputError(f"{what} must be a finite number, got {shown(value)}")
    return number


def _three(value: Any, unit: Any, what: str, expected: str = _VECTOR) -> np.ndarray:
    array = np.asarray(plain(value, unit, what), dtype=np.float64)
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be {expected}, got {value!r}")
    return array


def _unit(value: Any, what: str, expected: str = _VECTOR) -> np.ndarray:
    vector = _three(value, None, what, expected)
    if not np.any(vector):
        raise InputError(f"{what} must not be zero")
    return vector / np.linalg.norm(vector)
