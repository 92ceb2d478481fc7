"""An observer at a point: rays from one eye, onto a flat screen or a dome."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.types import Float
from ..errors import InputError, check_name
from ..geometry import angles_towards, image_axes, position_angle
from ..grids.arguments import on_grid
from ..grids.contract import Ray
from ..units import as_given, degrees, described, plain, radians, unit_of
from .contract import Camera, Frame, finite_degrees, pixel_counts, plane_size, sight_from, vector
from .stereo import SEEN_TWICE, check_stereo, doubled, halved, one_eye

if TYPE_CHECKING:
    from ..grids.contract import Grid
    from ..media import Medium
    from ..volume import Volume

PROJECTIONS = ("flat", "spherical")
# Bits that rounding may take from the direction to a target: 43 are left, 1e-13 of it.
_BITS = 10
# RADMC-3D's degree for the zenith angle.
_ZENITH_DEGREE = 57.295780


class Perspective(Camera):
    """Rays from one point, which may be inside the volume; z points up in the image.

    Parameters
    ----------
    position : three floats or Quantity
        Where the observer is, in the volume's unit.
    target : three floats or Quantity
        The point in the middle of the image.
    fov : float or Quantity, optional
        Angle across the (longer side of the) image; plain numbers are degrees. Default 45.
    width : float, Quantity or pair of them, optional
        Size of the image in radians as RADMC-3D's ``sizeradian``, instead of `fov`: on a flat
        screen at unit distance, or along the dome.
    up : three floats, optional
        The direction that points upwards in the image; z by default.
    posang : float or Quantity
        Position angle, instead of `up`.
    resolution : int or (int, int)
        Pixels, ``n`` or ``(nx, ny)``.
    projection : {"flat", "spherical"}
        A flat screen (straight lines stay straight), or a dome: the distance from the middle is the
        angle to it, for planetariums and all-sky pictures.
    zenith : float or Quantity
        Tilts the dome: angle between its middle and the target.
    stereo : {"side-by-side", "over-under"}, optional
        Two pictures in one, for the left eye (on the left, or above) and the right one, on a flat
        screen; what is as far as the target appears in the plane of the screen. The picture has
        twice the pixels: `resolution` is that of one eye.
    eye_distance : float or Quantity, optional
        Distance between the eyes in the volume's unit. Default: a thirtieth of the distance to the
        target.

    Raises
    ------
    InputError
        If position or target are not three finite numbers, or coincide, `up` is parallel to the
        line of sight, both `fov` and `width` or both `up` and `posang` are given, or the field of
        view does not fit the projection (below 180 degrees on a flat screen).

    Notes
    -----
    The conventions are those of RADMC-3D 2.0's local observer, projections 1 and 2.
    """

    plane_unit = "rad"

    def __init__(
        self,
        position: Any,
        target: Any,
        fov: Any = None,
        *,
        width: Any = None,
        up: Any = None,
        posang: Any = None,
        resolution: Any = 400,
        projection: str = "flat",
        zenith: Any = 0.0,
        stereo: str | None = None,
        eye_distance: Any = None,
    ) -> None:
        check_name("projection", projection, PROJECTIONS)
        if fov is not None and width is not None:
            raise InputError("give fov (an angle) or width (radians on the screen), not both")
        if up is not None and posang is not None:
            raise InputError("give up (a direction) or posang (an angle), not both")
        self.position, self.target = as_given(position, "position"), as_given(target, "target")
        position, looked_at = (
            vector(p, name) for p, name in ((self.position, "position"), (self.target, "target"))
        )
        self.projection = projection
        check_stereo(stereo, eye_distance)
        if stereo is not None and projection != "flat":
            raise InputError("stereo needs a flat screen; vm.Panorama has stereo in all directions")
        self.stereo, self.eye_distance = stereo, eye_distance
        pixels = pixel_counts(resolution)
        self.resolution = doubled(pixels, stereo)
        self.zenith = finite_degrees(zenith, "zenith")
        self.posang = 0.0 if posang is None else finite_degrees(posang, "posang")
        self.up = None if up is None else vector(up, "up")
        if unit_of(self.position) == unit_of(self.target):  # else it depends on the volume's unit
            self._axes(position, looked_at)
        size = _screen(45.0 if fov is None else fov, projection) if width is None else width
        self.width = doubled(plane_size(radians(size, "width"), pixels, "width"), stereo)
        if projection == "spherical" and max(self.width) > 2.0 * np.pi * (1.0 + 1e-12):
            raise InputError(f"a dome is at most 2π radians wide, got {max(self.width):g}")

    def _axes(self, position: np.ndarray, target: np.ndarray) -> np.ndarray:
        if np.array_equal(position, target):
            raise InputError("position and target of a perspective camera must not coincide")
        incl, phi = angles_towards(position - target)
        posang = self.posang if self.up is None else position_angle(incl, phi, self.up)
        return image_axes(incl, phi, posang)

    @classmethod
    def looking(cls, position: Any, view_direction: Any, **options: Any) -> Perspective:
        """Return a camera from its position and the direction it looks into."""
        unit = unit_of(as_given(position, "position"))
        parts = position if unit is not None and isinstance(position, (list, tuple)) else ()
        if any(unit_of(p) is None and np.any(plain(p, None, "position")) for p in parts):
            raise InputError(
                f"position must have units for all of its numbers or none, got {position!r}"
            )
        eye, direction = vector(position, "position"), vector(view_direction, "view_direction")
        # A step of one is lost in rounding where coordinates are 1e18, as in centimetres. Powers of
        # two change no digit of it.
        (_, far), (_, near) = (np.frexp(np.abs(v).max()) for v in (eye, direction))
        target = eye + np.ldexp(direction, max(0, int(far) - int(near) - _BITS))
        return cls(position, target if unit is None else target * unit, **options)

    @classmethod
    def framing(
        cls,
        volume: Volume,
        medium: Medium | None = None,
        incl: Any = None,
        phi: Any = None,
        *,
        view: str | None = None,
        fov: Any = None,
        resolution: Any = 400,
    ) -> Perspective:
        """Return a camera near the visible part of a medium.

        It looks at the middle of the frame of `Orthographic.framing`, and a cube as wide as that
        frame fills the picture.

        Parameters
        ----------
        volume, medium, incl, phi, view, resolution
            As for `Orthographic.framing`.
        fov : float or Quantity, optional
            As for `Perspective`: 45 degrees by default.

        Returns
        -------
        Perspective
            Its position and target are plain numbers in the volume's unit of length.

        Raises
        ------
        InputError, UnknownNameError
            As for `Orthographic.framing`; and if `fov` is not between 0 and 180 degrees.
        """
        angle = degrees(45.0 if fov is None else fov, "fov")
        _screen(angle, "flat")
        from ..rendering import framing

        found = framing.framed_or_warned(volume, medium, incl, phi, view, resolution)
        position, target, up = framing.perspective(*found, volume, angle)
        return cls(position, target, angle, up=up, resolution=resolution)

    @property
    def straight(self) -> bool:
        return self.projection == "flat" and self.stereo is None

    def frame(self, grid: Grid) -> Frame:
        position = vector(on_grid(self.position, grid, "position"), "position")
        target = vector(on_grid(self.target, grid, "target"), "target")
        axes = self._axes(position, target)
        tilt = self.zenith / _ZENITH_DEGREE
        c, s = np.cos(tilt), np.sin(tilt)
        tilted = np.stack([axes[0], c * axes[1] + s * axes[2], -s * axes[1] + c * axes[2]])
        vectors = [position, *tilted]
        if self.stereo is not None:
            away = float(np.linalg.norm(target - position))
            eyes = away / 30.0
            if self.eye_distance is not None:
                eyes = float(on_grid(self.eye_distance, grid, "eye_distance"))
            half = 0.5 * self.width[0 if self.stereo == "side-by-side" else 1] / 2
            vectors.append([0.5 * eyes, 0.5 * eyes / away, half])
        return Frame(self.resolution, self.width, (0.0, 0.0), np.vstack(vectors))

    def rays(self, vectors: list[list[Float]], u: Float, v: Float) -> Ray:
        position, ex, ey, ez = vectors[:4]
        zero = type(u)(0)
        origin = [zero + p for p in position]
        if self.stereo is not None:
            half_eyes, parallax, half = vectors[4]
            u, v, side = one_eye(self.stereo, u, v, half)
            u = u - side * parallax
            origin = [o + side * half_eyes * x for o, x in zip(origin, ex, strict=True)]
        if self.projection == "flat":
            inverse = 1.0 / dr.sqrt(1.0 + u * u + v * v)
            across, along, back = u * inverse, v * inverse, inverse
        else:
            q = dr.sqrt(u * u + v * v)
            sinc = dr.select(q > 0, dr.sin(q) / dr.select(q > 0, q, 1.0), 1.0)
            across, along, back = u * sinc, v * sinc, dr.cos(q)
        direction = [across * x + along * y - back * z for x, y, z in zip(ex, ey, ez, strict=True)]
        return Ray(origin, direction, first=zero)

    def key(self) -> Hashable:
        exact = type(self) is Perspective
        return ("perspective", self.projection, self.stereo) if exact else None

    def lines_of_sight(self, points: np.ndarray, grid: Grid) -> np.ndarray:
        return sight_from(vector(on_grid(self.position, grid, "position"), "position"), points)

    def project(self, points: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self.stereo is not None:
            raise InputError(SEEN_TWICE)
        position, *axes = self.frame(grid).vectors
        away = np.asarray(points, dtype=np.float64) - position[:, None]
        across, along, back = np.stack(axes) @ away
        aside = np.hypot(across, along)
        if self.projection == "flat":
            ahead = np.where(back < 0.0, -back, np.nan)
            return across / ahead, along / ahead, np.hypot(aside, ahead)
        angle = np.arctan2(aside, -back)
        # Straight ahead the angle's sine is the angle; straight behind there is no direction.
        stretch = np.where(aside > 0.0, angle, np.where(back < 0.0, 1.0, np.nan))
        stretch /= np.where(aside > 0.0, aside, np.where(back < 0.0, -back, 1.0))
        return across * stretch, along * stretch, np.hypot(aside, back)

    def within(self, size: tuple[int, int]) -> Camera:
        nx, ny = halved(size, self.stereo)
        if self.stereo is not None or self.projection == "spherical":
            # Shown as a whole: its pixels are to be square.
            width, height = halved(self.width, self.stereo)
            pixel = max(width / max(nx, 1), height / max(ny, 1))
            nx, ny = round(width / pixel), round(height / pixel)
        return self.replace(resolution=(max(1, nx), max(1, ny)))

    def describe(self) -> dict[str, Any]:
        values: dict[str, Any] = {
            "type": "perspective",
            "projection": self.projection,
            "position": described(self.position),
            "target": described(self.target),
            "width": list(halved(self.width, self.stereo)),
            "resolution": list(halved(self.resolution, self.stereo)),
        }
        if self.stereo is not None:
            values["stereo"] = self.stereo
            if self.eye_distance is not None:
                values["eye_distance"] = described(self.eye_distance)
        if self.up is not None:
            values["up"] = self.up.tolist()
        elif self.posang:
            values["posang"] = self.posang
        if self.zenith:
            values["zenith"] = self.zenith
        return values


def _screen(fov: Any, projection: str) -> float:
    angle = degrees(fov, "fov")
    if projection == "spherical":
        return float(np.deg2rad(angle))
    if not 0 < angle < 180:
        raise InputError(
            f"on a flat screen fov must be between 0 and 180 degrees, got {angle:g}; "
            "use projection='spherical' for more"
        )
    return float(2.0 * np.tan(np.deg2rad(0.5 * angle)))
