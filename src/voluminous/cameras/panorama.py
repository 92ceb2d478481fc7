"""An observer who looks in all directions: for headsets, domes and spherical films."""

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
from ..units import as_given, degrees, described, is_quantity
from .contract import Camera, Frame, finite_degrees, pixel_counts, sight_from, vector
from .stereo import SEEN_TWICE, check_stereo, doubled, halved, one_eye

if TYPE_CHECKING:
    from ..grids.contract import Grid

PROJECTIONS = ("equirectangular", "fulldome", "cubemap")
# Width and height of one eye's picture.
_RATIOS = {"equirectangular": (2, 1), "fulldome": (1, 1), "cubemap": (3, 2)}
# Right, up and towards the observer, of each face of the cube, in the observer's axes: the right,
# left and upper face above the lower, front and back one.
_FACES = (
    ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
)


class Panorama(Camera):
    """All directions around one point, which is usually inside the volume.

    Parameters
    ----------
    position : three floats or Quantity
        Where the observer is, in the volume's unit.
    target : three floats or Quantity
        The point in the middle of the picture (of the front face of a cube).
    projection : {"equirectangular", "fulldome", "cubemap"}
        "equirectangular": longitude and latitude, twice as wide as high, as players of spherical
        films expect. "fulldome": a disc in an empty square, whose radius is the angle to its
        middle; for planetariums, whose middle is the zenith. "cubemap": the six faces of a cube,
        three beside each other in two rows: right, left, up; down, front, back.
    resolution : int
        Pixels across the picture of one eye: even for "equirectangular", a multiple of three for
        "cubemap". Default 1200.
    fov : float or Quantity, optional
        Angle across the disc of "fulldome"; plain numbers are degrees. Default 180.
    stereo : {"over-under", "side-by-side"}, optional
        Two pictures in one, for the left eye (above, or on the left) and the right one, of
        "equirectangular": in every direction both eyes look straight ahead from the ends of a line
        across it.
    eye_distance : float or Quantity, optional
        Distance between the eyes in the volume's unit. Default: a thirtieth of the distance to the
        target.
    up : three floats, optional
        The direction that points upwards; z by default.
    posang : float or Quantity
        Position angle, instead of `up`.

    Raises
    ------
    InputError
        If an argument is not of the kind described, or position and target coincide.

    Notes
    -----
    Stereo is the omni-directional projection of Peleg, Ben-Ezra & Pritch (2001, IEEE PAMI 23,
    279): the eyes of a column of pixels lie on a horizontal circle. Straight up and down there is
    no right distance of the eyes; objects such as stars are refused.

    Examples
    --------
    >>> import voluminous as vm
    >>> camera = vm.Panorama((0, 0, 0), (0, 1, 0), resolution=512)
    >>> camera.resolution
    (512, 256)
    """

    plane_unit = "rad"

    def __init__(
        self,
        position: Any,
        target: Any,
        *,
        projection: str = "equirectangular",
        resolution: Any = 1200,
        fov: Any = None,
        stereo: str | None = None,
        eye_distance: Any = None,
        up: Any = None,
        posang: Any = None,
    ) -> None:
        check_name("projection", projection, PROJECTIONS)
        if up is not None and posang is not None:
            raise InputError("give up (a direction) or posang (an angle), not both")
        if fov is not None and projection != "fulldome":
            raise InputError(f"fov is for fulldome; {projection} shows all directions")
        if stereo is not None and projection != "equirectangular":
            raise InputError(f"stereo needs projection='equirectangular', got {projection!r}")
        check_stereo(stereo, eye_distance)
        self.position, self.target = as_given(position, "position"), as_given(target, "target")
        eye, aim = (vector(p, "point") for p in (self.position, self.target))
        if not is_quantity(position) and not is_quantity(target) and np.array_equal(eye, aim):
            raise InputError("position and target of a panorama must not coincide")
        self.projection, self.stereo, self.eye_distance = projection, stereo, eye_distance
        self.up = None if up is None else vector(up, "up")
        self.posang = 0.0 if posang is None else finite_degrees(posang, "posang")
        self.fov = float(np.deg2rad(180.0 if fov is None else degrees(fov, "fov")))
        if not 0.0 < self.fov <= 2.0 * np.pi:
            raise InputError(f"fov must be between 0 and 360 degrees, got {fov!r}")
        self.resolution = doubled(_pixels(resolution, projection, stereo), stereo)

    @property
    def _one(self) -> tuple[float, float]:
        if self.projection == "equirectangular":
            return 2.0 * np.pi, np.pi
        return (self.fov, self.fov) if self.projection == "fulldome" else (3.0, 2.0)

    def frame(self, grid: Grid) -> Frame:
        position = vector(on_grid(self.position, grid, "position"), "position")
        target = vector(on_grid(self.target, grid, "target"), "target")
        away = position - target
        if not np.any(away):
            raise InputError("position and target of a panorama must not coincide")
        incl, phi = angles_towards(away)
        posang = self.posang if self.up is None else position_angle(incl, phi, self.up)
        axes = image_axes(incl, phi, posang)
        eyes = np.linalg.norm(away) / 30.0
        if self.eye_distance is not None:
            eyes = float(on_grid(self.eye_distance, grid, "eye_distance"))
        size = doubled(self._one, self.stereo)
        return Frame(
            self.resolution,
            size,
            (0.0, 0.0),
            np.vstack([position, axes, [0.5 * eyes, 0.5 * self.fov, 0]]),
        )

    def rays(self, vectors: list[list[Any]], u: Any, v: Any) -> Ray:
        position, ex, ey, ez, (half_eyes, radius, _) = vectors
        side = active = None
        if self.projection == "equirectangular":
            half = np.pi if self.stereo == "side-by-side" else 0.5 * np.pi
            u, v, side = one_eye(self.stereo, u, v, half)
            (sin_u, cos_u), (sin_v, cos_v) = dr.sincos(u), dr.sincos(v)
            x, y, z = cos_v * sin_u, sin_v, -cos_v * cos_u
        elif self.projection == "fulldome":
            q = dr.sqrt(u * u + v * v)
            sinc = dr.select(q > 0, dr.sin(q) / dr.select(q > 0, q, 1.0), 1.0)
            x, y, z = u * sinc, v * sinc, -dr.cos(q)
            active = q <= radius
        else:
            x, y, z = _on_cube(u, v)
        direction = [x * a + y * b + z * c for a, b, c in zip(ex, ey, ez, strict=True)]
        zero = type(u)(0)
        origin = [zero + p for p in position]
        if side is not None:
            step = side * half_eyes
            origin = [
                o + step * (cos_u * a + sin_u * c) for o, a, c in zip(origin, ex, ez, strict=True)
            ]
        return Ray(origin, direction, first=zero, active=active)

    def key(self) -> Hashable:
        exact = type(self) is Panorama
        return ("panorama", self.projection, self.stereo) if exact else None

    def lines_of_sight(self, points: np.ndarray, grid: Grid) -> np.ndarray:
        return sight_from(vector(on_grid(self.position, grid, "position"), "position"), points)

    def project(self, points: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self.stereo is not None:
            raise InputError(SEEN_TWICE)
        position, *axes = self.frame(grid).vectors[:4]
        away = np.asarray(points, dtype=np.float64) - position[:, None]
        distance = np.linalg.norm(away, axis=0)
        with np.errstate(invalid="ignore"):
            x, y, z = np.stack(axes) @ away / distance
        if self.projection == "equirectangular":
            return np.arctan2(x, -z), np.arcsin(np.clip(y, -1.0, 1.0)), distance
        if self.projection == "fulldome":
            aside = np.hypot(x, y)
            angle = np.arctan2(aside, -z)
            stretch = np.where(aside > 0, angle / np.where(aside > 0, aside, 1.0), 1.0)
            inside = (aside > 0) | (z < 0)
            return *(np.where(inside, stretch * w, np.nan) for w in (x, y)), distance
        u, v = np.full((2, len(x)), np.nan)
        for k, (right, up, back) in enumerate(_FACES):
            depth = -(np.asarray(back) @ (x, y, z))
            with np.errstate(invalid="ignore", divide="ignore"):
                s, t = (np.asarray(a) @ (x, y, z) / depth for a in (right, up))
            inside = (depth > 0) & (np.abs(s) <= 1) & (np.abs(t) <= 1) & np.isnan(u)
            u[inside] = (k % 3 - 1 + 0.5 * s)[inside]
            v[inside] = (0.5 - k // 3 + 0.5 * t)[inside]
        return u, v, distance

    def within(self, size: tuple[int, int]) -> Camera:
        (nx, ny), (parts, rows) = halved(size, self.stereo), _RATIOS[self.projection]
        return self.replace(resolution=parts * max(1, min(nx // parts, ny // rows)))

    def describe(self) -> dict[str, Any]:
        settings: dict[str, Any] = {"type": "panorama", "projection": self.projection}
        settings["position"], settings["target"] = described(self.position), described(self.target)
        one = self.resolution[0]
        settings["resolution"] = one // 2 if self.stereo == "side-by-side" else one
        if self.projection == "fulldome":
            settings["fov"] = float(np.rad2deg(self.fov))
        if self.stereo is not None:
            settings["stereo"] = self.stereo
            if self.eye_distance is not None:
                settings["eye_distance"] = described(self.eye_distance)
        if self.up is not None:
            settings["up"] = self.up.tolist()
        elif self.posang:
            settings["posang"] = self.posang
        return settings


def _pixels(resolution: Any, projection: str, stereo: str | None) -> tuple[int, int]:
    """Return the pixels of one eye's picture; a pair of numbers must be that, or all pixels."""
    nx, ny = pixel_counts(resolution)
    parts, rows = _RATIOS[projection]
    fits = nx % parts == 0
    if isinstance(resolution, (list, tuple)) and fits:
        fits = ny * parts == nx * rows
    if not fits:
        raise InputError(
            f"the resolution of {projection} must be a multiple of {parts} pixels across, with "
            f"{rows}/{parts} of it upwards, got {resolution!r}"
        )
    return nx, nx * rows // parts


def _on_cube(u: Float, v: Float) -> list[Float]:
    column = dr.clip(dr.floor(u + 1.5), 0, 2)
    row = dr.select(v >= 0, type(u)(0), type(u)(1))
    s, t = 2.0 * (u + 1.0 - column), 2.0 * (v - 0.5 + row)
    length = dr.rsqrt(s * s + t * t + 1.0)
    total = [type(u)(0)] * 3
    for k, (right, up, back) in enumerate(_FACES):
        here = dr.select((column == k % 3) & (row == k // 3), length, 0.0)
        parts = zip(total, right, up, back, strict=True)
        total = [w + here * (a * s + b * t - c) for w, a, b, c in parts]
    return total
