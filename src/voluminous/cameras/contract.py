"""The contract of a camera: pixels and rays; and the vectors and lengths that one is given."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend.types import Float
from ..errors import InputError
from ..grids.contract import Ray
from ..units import Unit, degrees, is_count, plain, unit_of
from ..value import Value

if TYPE_CHECKING:
    from ..backend import Backend
    from ..grids.contract import Grid


@dataclass(frozen=True)
class Frame:
    """Pixels and rays of a camera before a volume, as plain numbers."""

    #: Number of pixels (nx, ny).
    pixels: tuple[int, int]
    #: Width and height of the image plane, in the volume's length unit or in radians.
    width: tuple[float, float]
    #: Image-plane coordinates of its centre.
    shift: tuple[float, float]
    #: From which rays follow, shape (k, 3); run-time data of the kernel.
    vectors: np.ndarray

    @property
    def pixel(self) -> tuple[float, float]:
        """Width and height of a pixel."""
        return self.width[0] / self.pixels[0], self.width[1] / self.pixels[1]

    def traced_vectors(self, backend: Backend) -> list[list[Float]]:
        """Return the vectors as `Camera.rays` takes them: run-time numbers of a kernel."""
        return [[backend.wide(c) for c in vector] for vector in self.vectors]

    def coordinates(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the image-plane coordinates of the pixel centres, x and y."""
        x, y = (
            shift + (np.arange(n) - 0.5 * (n - 1)) * step
            for n, step, shift in zip(self.pixels, self.pixel, self.shift, strict=True)
        )
        return x, y


class Camera(Value):
    """Where rays come from; plain data, without a volume."""

    #: Unit of the image plane: "" stands for the volume's length unit.
    plane_unit = ""
    #: True if the observer is at infinity.
    parallel = False

    @property
    def straight(self) -> bool:
        """Whether `project` shows straight lines in front of the camera as straight lines."""
        return False

    def frame(self, grid: Grid) -> Frame:
        """Return the camera's pixels and vectors for a grid, in the grid's unit.

        Raises
        ------
        UnitsError
            If the camera's lengths cannot be converted to the grid's unit.
        """
        raise NotImplementedError

    def rays(self, vectors: list[list[Float]], u: Float, v: Float) -> Ray:
        """Return the rays through image-plane points; traced into the kernel.

        ``origin + t direction`` runs away from the camera.
        """
        raise NotImplementedError

    def key(self) -> Hashable:
        """Return what decides how `rays` is traced, besides the numbers it is given.

        Kernels are used again for an equal key; never, if it is None.
        """
        return None

    def lines_of_sight(self, points: np.ndarray, grid: Grid) -> np.ndarray:
        """Return unit vectors from the observer to points, and beyond; zero at the observer.

        Points are in the unit of the grid, shape (3, n), as the result. Expressions with
        ``los(...)`` need this method; by default it raises an InputError.
        """
        raise InputError(
            f"{type(self).__name__} does not tell its lines of sight, which los(...) needs; give "
            "it a method lines_of_sight(points, grid)"
        )

    def project(self, points: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return where points are seen on the image plane, and how far away: the inverse of `rays`.

        Points are in the unit of the grid, shape (3, n). Pictures with objects need this method; by
        default it raises an InputError.

        Returns
        -------
        u, v, depth : float64 arrays, shape (n,)
            Image-plane coordinates, and the distance along the ray through them from its origin;
            NaN where a point is on no ray, such as behind the observer.
        """
        raise InputError(
            f"{type(self).__name__} does not tell where points are seen, which objects in pictures "
            "need; give it a method project(points, grid)"
        )

    def within(self, size: tuple[int, int]) -> Camera:
        """Return this camera with the largest picture of its shape in so many pixels (nx, ny)."""
        return self.replace(resolution=size)

    def describe(self) -> dict[str, Any]:
        """Return type and arguments as plain values, as in a scene file."""
        raise NotImplementedError

    def __repr__(self) -> str:
        arguments = ", ".join(f"{k}={v!r}" for k, v in self.describe().items() if k != "type")
        return f"{type(self).__name__}({arguments})"


def check_camera(camera: Any, who: str) -> None:
    """Refuse other objects, and classes of cameras."""
    made = not isinstance(camera, type)
    if not (made and hasattr(camera, "frame") and hasattr(camera, "rays")):
        raise InputError(
            f"{who} needs a camera (vm.Orthographic(…), vm.Perspective(…)), got "
            f"{type(camera).__name__ if made else f'the class {camera.__name__}'}"
        )


def pixel_counts(resolution: Any) -> tuple[int, int]:
    """Return (nx, ny) from a whole number or a pair of them."""
    listed = isinstance(resolution, (list, tuple)) or np.ndim(resolution) == 1
    pair = tuple(resolution) if listed else (resolution, resolution)
    if len(pair) != 2 or any(isinstance(n, bool) or not is_count(n, 1 << 63) for n in pair):
        raise InputError(
            f"resolution must be a positive whole number or (nx, ny), got {resolution!r}"
        )
    return int(pair[0]), int(pair[1])


def plane_size(width: Any, pixels: tuple[int, int], what: str) -> tuple[float, float]:
    """Return (w, h) from a number or a pair; one number is the longer side, with square pixels."""
    size = np.atleast_1d(np.asarray(width, dtype=np.float64))
    if size.shape not in ((1,), (2,)) or not np.all(np.isfinite(size)) or size.min() <= 0:
        raise InputError(
            f"{what} must be a positive number or a pair (w, h) of them, got {width!r}"
        )
    first, *rest = size.tolist()
    return (first, *rest) if rest else tuple(first * n / max(pixels) for n in pixels)


def vector(value: Any, what: str, *unit: Unit, length: int = 3) -> np.ndarray:
    """Return finite floats in a unit; without one in their own: only the direction counts."""
    array = np.asarray(plain(value, unit[0] if unit else unit_of(value), what), dtype=np.float64)
    if array.shape != (length,) or not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be {length} finite numbers, got {value!r}")
    return array


def finite_degrees(value: Any, what: str) -> float:
    """Return an angle in degrees; plain numbers are degrees."""
    angle = degrees(value, what)
    if not np.isfinite(angle):
        raise InputError(f"{what} must be finite, got {angle}")
    return angle


def sight_from(eye: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return unit vectors from a point to others (3, n); zero where they are the same."""
    away = np.asarray(points) - eye[:, None]
    distance = np.linalg.norm(away, axis=0)
    return np.asarray(away / np.where(distance > 0, distance, 1.0))
