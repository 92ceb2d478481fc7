"""Paths of cameras: lists with one camera per frame. Lists can be added and cut as all lists."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from ..cameras import Camera, Orthographic, Panorama, Perspective
from ..cameras.contract import vector
from ..cameras.stereo import halved
from ..errors import InputError, check_name
from ..geometry import angles_towards, image_axes, position_angle
from ..units import as_given, is_count, plain, shown, unit_of

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

EASES = ("smooth", "linear", "through")


def orbit(
    camera: Camera, turns: float = 1.0, frames: int = 240, *, axis: Any = (0.0, 0.0, 1.0)
) -> list[Camera]:
    """Return cameras that go around what they see; a panorama turns around itself.

    Parameters
    ----------
    camera : Orthographic, Perspective or Panorama
        The first one.
    turns : float
        Revolutions; whole ones make a film that can be repeated without a jump. What is seen turns
        counterclockwise around the axis: `phi` grows where that is z.
    frames : int
        Number of cameras.
    axis : three floats
        Axis of the rotation, through the target or the middle of the picture.

    Returns
    -------
    list of Camera

    Raises
    ------
    InputError
        If the number of frames is not positive, or the axis is zero.

    Examples
    --------
    >>> import voluminous as vm
    >>> [round(c.phi) for c in vm.orbit(vm.Orthographic(60, 0), frames=4)]
    [0, 90, 180, 270]
    """
    from scipy.spatial.transform import Rotation

    direction = vector(axis, "axis")
    if not np.any(direction):
        raise InputError("axis must be a non-zero vector")
    angle = 2.0 * np.pi * _finite(turns, "turns") / _count(frames)
    start, unit = Pose.of(camera), direction / np.linalg.norm(direction)

    def at(k: int) -> Camera:
        if k == 0:
            return camera
        if isinstance(camera, Orthographic) and unit[2] == 1.0:
            return camera.replace(phi=camera.phi + np.rad2deg(k * angle))
        turn = Rotation.from_rotvec(-k * angle * unit)
        return start.moved(rotation=turn * start.rotation).camera(camera)

    return [at(k) for k in range(frames)]


def zoom(camera: Camera, factor: float, frames: int = 240) -> list[Camera]:
    """Return cameras whose pictures show less and less, each by the same factor.

    The width of an orthographic picture, or the field of view of a perspective one, shrinks. A
    perspective camera comes closer with `dolly`.

    Parameters
    ----------
    camera : Orthographic or Perspective
        The first one; an orthographic one needs a width.
    factor : float
        First width over last: 1000 for three decades; below one it shows more and more.
    frames : int
        Number of cameras.

    Returns
    -------
    list of Camera

    Raises
    ------
    InputError
        If the camera has no width, or the factor is not positive.
    """
    start = Pose.of(camera)
    if start.width is None:
        raise InputError("zoom needs a camera with a width; give width=, or use dolly")
    steps = _geometric(factor, frames)
    return [start.moved(width=start.width / f).camera(camera) for f in steps]


def dolly(camera: Camera, factor: float, frames: int = 240) -> list[Camera]:
    """Return cameras that come closer to their target, each by the same factor.

    Parameters
    ----------
    camera : Perspective or Panorama
        The first one.
    factor : float
        First distance over last; below one it goes away.
    frames : int
        Number of cameras.

    Returns
    -------
    list of Camera

    Raises
    ------
    InputError
        If the camera has no position, or the factor is not positive.
    """
    start = Pose.of(camera)
    if start.distance is None:
        raise InputError("dolly needs a camera with a position (vm.Perspective, vm.Panorama)")
    steps = _geometric(factor, frames)
    return [start.moved(distance=start.distance / f).camera(camera) for f in steps]


def fly(positions: Any, frames: int = 240, **options: Any) -> list[Camera]:
    """Return perspective cameras on a smooth curve through points, which look ahead.

    Parameters
    ----------
    positions : array_like or Quantity, shape (n, 3)
        Points of the curve, a cubic spline, which is flown at constant speed.
    frames : int
        Number of cameras.
    **options
        Those of `Perspective`, such as ``fov`` and ``resolution``; ``target`` to look at one point.

    Returns
    -------
    list of Perspective

    Raises
    ------
    InputError
        If there are fewer than two different points.
    """
    from scipy.interpolate import CubicSpline

    given = as_given(positions, "positions")
    unit = unit_of(given)
    points = np.asarray(plain(given, unit, "positions"), dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or not np.isfinite(points).all():
        raise InputError(f"positions must be two or more points (x, y, z), got {positions!r}")
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if not np.all(steps > 0):
        raise InputError("two positions after each other must differ")
    curve = CubicSpline(np.concatenate([[0.0], np.cumsum(steps)]), points)
    fine = np.linspace(0.0, curve.x[-1], 64 * len(points))
    speed = np.linalg.norm(curve(fine, 1), axis=1)
    length = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(fine))])
    places = np.interp(np.linspace(0.0, length[-1], _count(frames)), length, fine)
    target = options.pop("target", None)

    def with_unit(vector: np.ndarray) -> Any:
        return vector.tolist() if unit is None else vector * unit

    def ahead(s: float) -> Any:
        # A target a hundredth of the way ahead: further than rounding of coordinates.
        return with_unit(curve(s) + curve(s, 1) * (0.01 * length[-1]))

    return [
        Perspective(with_unit(curve(s)), ahead(s) if target is None else target, **options)
        for s in places
    ]


def keyframes(keys: Sequence[tuple[int, Camera]], ease: str = "smooth") -> list[Camera]:
    """Return cameras that go from one to the next: one per frame.

    Parameters
    ----------
    keys : sequence of (int, Camera)
        The frame in which each camera is reached, in ascending order. All cameras are of one kind;
        options that do not change smoothly (resolution, projection) are those of the first.
    ease : {"smooth", "linear", "through"}
        "smooth": each way starts and ends at rest. "linear": at constant speed. "through": a smooth
        curve through all keys, at rest in none.

    Returns
    -------
    list of Camera
        From the first key's frame to the last one's, both included.

    Raises
    ------
    InputError
        If frames do not ascend, or the cameras do not fit each other.

    Notes
    -----
    Widths and distances change by equal factors, directions along great circles (Shoemake 1985,
    SIGGRAPH 19, 245). Between two widths the middle of the picture moves in proportion to the
    width, so that a zoom goes straight to what it ends at.
    """
    from scipy.spatial.transform import Rotation, RotationSpline, Slerp

    check_name("ease", ease, EASES)
    pairs = keys if isinstance(keys, (list, tuple)) else ()
    if not pairs or not all(isinstance(pair, (list, tuple)) and len(pair) == 2 for pair in pairs):
        raise InputError(
            "keyframes needs pairs of a frame and a camera, such as [(0, first), (60, last)], got "
            f"{shown(keys)}"
        )
    at = [frame for frame, _ in keys]
    whole = all(isinstance(frame, Real) and is_count(frame + 1, 1 << 31) for frame in at)
    if not whole or any(np.diff(at) <= 0):
        raise InputError(f"frames of keys must be whole numbers that ascend, got {at}")
    first = keys[0][1]
    poses = [Pose.of(camera) for _, camera in keys]
    if len({type(camera) for _, camera in keys}) > 1:
        raise InputError("all keyframes must be cameras of one kind")
    if len(keys) == 1:
        return [first]
    unit = poses[0].unit
    rows = np.array([pose.numbers(unit) for pose in poses])
    if len({tuple(np.isnan(row)) for row in rows}) > 1:
        raise InputError("give width and center to all keyframes, or to none")
    rotations = Rotation.concatenate([pose.rotation for pose in poses])
    frames = np.arange(at[0], at[-1] + 1)
    turns: Callable[[Any], Rotation]
    if ease == "through":
        places, turns = _through(at, rows, frames), RotationSpline(at, rotations)
        times = frames.astype(float)
    else:
        times = _eased(at, frames, ease)
        places, turns = _between(at, rows, times), Slerp(at, rotations)
    return [
        poses[0].with_numbers(row, turns(float(time))).camera(first)
        for row, time in zip(places, times, strict=True)
    ]


@dataclass(frozen=True)
class Pose:
    """Where a camera is, and how it is turned, as numbers that may be interpolated.

    Attributes
    ----------
    middle : array, shape (3,)
        The point in the middle of the picture, of a panorama the observer; NaN if it is open.
    rotation : Rotation
        Turns the axes (right, up, towards the observer) of a view along -z into the camera's.
    width : array, shape (2,), or None
        Size of the image plane.
    distance : float or None
        From the observer to the target.
    shift : array, shape (2,)
        Of an orthographic picture.
    unit : unit or None
        Of all lengths.
    """

    middle: np.ndarray
    rotation: Rotation
    width: np.ndarray | None
    distance: float | None
    shift: np.ndarray
    unit: Any

    @classmethod
    def of(cls, camera: Camera) -> Pose:
        from scipy.spatial.transform import Rotation

        none = np.zeros(2)
        if isinstance(camera, Orthographic):
            axes = image_axes(camera.incl, camera.phi, camera.posang)
            lengths = (camera.center, camera.width, camera.shift)
            unit = next((u for u in map(unit_of, lengths) if u is not None), None)
            center = np.full(3, np.nan)
            if camera.center is not None:
                center = _plain(camera.center, unit)
            width = None
            if camera.width is not None:
                nx, ny = camera.resolution
                width = _plain(camera.width, unit)
                width = width if width.shape else width * np.array([nx, ny]) / max(nx, ny)
            shift = _plain(camera.shift, unit)
            return cls(center, Rotation.from_matrix(axes.T), width, None, shift, unit)
        if not isinstance(camera, (Perspective, Panorama)):
            raise InputError(
                f"paths need an Orthographic, Perspective or Panorama camera, got "
                f"{type(camera).__name__}"
            )
        unit = unit_of(camera.position) or unit_of(camera.target)
        position, target = _plain(camera.position, unit), _plain(camera.target, unit)
        away = position - target
        incl, phi = angles_towards(away)
        posang = camera.posang if camera.up is None else position_angle(incl, phi, camera.up)
        rotation = Rotation.from_matrix(image_axes(incl, phi, posang).T)
        distance = float(np.linalg.norm(away))
        if isinstance(camera, Panorama):
            return cls(position, rotation, None, distance, none, unit)
        one = np.array(halved(camera.width, camera.stereo))
        return cls(target, rotation, one, distance, none, unit)

    def moved(self, **changes: Any) -> Pose:
        return Pose(**{**vars(self), **changes})

    def numbers(self, unit: Any) -> np.ndarray:
        """Return all that is interpolated but the rotation, lengths in a unit."""
        if (unit is None) != (self.unit is None):
            raise InputError("give units to the lengths of all keyframes, or of none")
        scale = 1.0 if unit is None else float(self.unit.to(unit))
        angular = self.distance is not None
        width = np.full(2, np.nan) if self.width is None else self.width
        width = np.log(width) if angular else np.log(width * scale)
        distance = np.nan if self.distance is None else np.log(self.distance * scale)
        return np.array([*self.middle * scale, *self.shift * scale, *width, distance])

    def with_numbers(self, row: np.ndarray, rotation: Rotation) -> Pose:
        width = None if self.width is None else np.exp(row[5:7])
        distance = None if self.distance is None else float(np.exp(row[7]))
        return Pose(row[:3], rotation, width, distance, row[3:5], self.unit)

    def camera(self, like: Camera) -> Camera:
        """Return a camera at this pose, with the other options of another one."""
        axes = self.rotation.as_matrix().T
        incl, phi = angles_towards(axes[2])
        posang = position_angle(incl, phi, axes[1])
        if isinstance(like, Orthographic):
            center = None if np.isnan(self.middle).any() else self._with_unit(self.middle)
            width = None if self.width is None else self._with_unit(self.width)
            shift = self._with_unit(self.shift) if np.any(self.shift) else (0.0, 0.0)
            angles = {"incl": incl, "phi": phi, "posang": posang}
            return like.replace(**angles, center=center, width=width, shift=shift)
        assert self.distance is not None
        step = self.distance * axes[2]
        turned: dict[str, Any] = {"up": None, "posang": posang}
        if isinstance(like, Panorama):
            position, target = self.middle, self.middle - step
        else:
            position, target = self.middle + step, self.middle
            assert self.width is not None
            turned |= {"fov": None, "width": tuple(self.width.tolist())}
        places = {"position": self._with_unit(position), "target": self._with_unit(target)}
        return like.replace(**places, **turned)

    def _with_unit(self, vector: np.ndarray) -> Any:
        return vector.tolist() if self.unit is None else vector * self.unit


def _plain(value: Any, unit: Any) -> np.ndarray:
    given_unit = unit_of(value)
    if given_unit is None and unit is not None and np.any(np.asarray(value)):
        raise InputError(f"give units to all lengths of a camera or to none, got {value!r}")
    return np.asarray(
        plain(value, unit if given_unit is not None else None, "length"), dtype=np.float64
    )


def _count(frames: Any) -> int:
    if not is_count(frames, 1 << 31):
        raise InputError(f"frames must be a positive whole number, got {frames!r}")
    return int(frames)


def _finite(value: Any, what: str) -> float:
    number = plain(value, None, what)
    if not isinstance(number, float) or not np.isfinite(number):
        raise InputError(f"{what} must be a finite number, got {shown(value)}")
    return number


def _geometric(factor: Any, frames: Any) -> np.ndarray:
    if (ratio := _finite(factor, "factor")) <= 0.0:
        raise InputError(f"factor must be a positive number, got {factor!r}")
    count = _count(frames)
    return np.asarray(ratio ** (np.arange(count) / max(count - 1, 1)))


def _eased(at: list[int], frames: np.ndarray, ease: str) -> np.ndarray:
    k = np.clip(np.searchsorted(at, frames, side="right") - 1, 0, len(at) - 2)
    low, high = np.asarray(at, dtype=float)[k], np.asarray(at, dtype=float)[k + 1]
    t = (frames - low) / (high - low)
    t = t * t * (3.0 - 2.0 * t) if ease == "smooth" else t
    return np.asarray(np.clip(low + t * (high - low), at[0], at[-1]))


def _between(at: list[int], rows: np.ndarray, times: np.ndarray) -> np.ndarray:
    k = np.clip(np.searchsorted(at, times, side="right") - 1, 0, len(at) - 2)
    t = ((times - np.asarray(at)[k]) / np.diff(at)[k])[:, None]
    low, high = rows[k], rows[k + 1]
    places: np.ndarray = low + t * (high - low)
    wide, narrow, now = (np.exp(r[:, 5:6]) for r in (low, high, places))
    # What the way of the middle has in common with the zoom: w(t) - w(0) over w(1) - w(0).
    change = narrow - wide
    zooms = np.isfinite(change) & (np.abs(change) > 1e-9 * wide) & np.isnan(rows[0, 7])
    share = np.where(zooms, (now - wide) / np.where(zooms, change, 1.0), t)
    places[:, :5] = low[:, :5] + share * (high[:, :5] - low[:, :5])
    return places


def _through(at: list[int], rows: np.ndarray, frames: np.ndarray) -> np.ndarray:
    from scipy.interpolate import PchipInterpolator

    there = np.isfinite(rows[0])
    places = np.full((len(frames), rows.shape[1]), np.nan)
    places[:, there] = PchipInterpolator(at, rows[:, there])(frames)
    return places
