"""An observer at infinity: parallel rays."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend.types import Float
from ..errors import InputError
from ..geometry import angles_towards, image_axes, position_angle
from ..grids.arguments import on_grid
from ..grids.contract import Ray
from ..units import as_given, described, is_quantity, plain, unit_of
from .contract import Camera, Frame, finite_degrees, pixel_counts, plane_size, vector

if TYPE_CHECKING:
    from ..grids.contract import Grid
    from ..media import Medium
    from ..volume import Volume


class Orthographic(Camera):
    """Parallel rays, with RADMC-3D's angles.

    ``incl = 0`` looks down the z axis with x to the right and y up; at ``incl = 90, phi = 0`` the
    observer is at y = -∞ with x to the right, at ``phi = 90`` at x = -∞; z points up.

    Parameters
    ----------
    incl, phi, posang : float or Quantity
        Inclination, azimuth and position angle; plain numbers are degrees.
    width : float, Quantity or pair of them, optional
        Width (and height) of the image in the volume's unit; one number is the longer side. None
        frames the volume: nothing is cut off, from wherever it is seen.
    resolution : int or (int, int)
        Pixels, ``n`` or ``(nx, ny)``; pixels may be oblong.
    center : three floats or Quantity, optional
        The point in the middle of the image; the volume's centre by default.
    shift : (float, float) or Quantity
        Moves the frame in the image plane: the coordinates of its middle.

    Raises
    ------
    InputError
        For sizes that are not positive, or numbers that are not finite.

    Notes
    -----
    A pixel at (px, py) is the point ``center + px e_x + py e_y``, and light travels along ``e_z``,
    with the axes of `image_axes`. Coordinates of pixel centres are
    ``(i - (n - 1)/2) width/n`` as in RADMC-3D 2.0.
    """

    parallel = True

    def __init__(
        self,
        incl: Any = 0.0,
        phi: Any = 0.0,
        posang: Any = 0.0,
        width: Any = None,
        resolution: Any = 400,
        center: Any = None,
        *,
        shift: Any = (0.0, 0.0),
    ) -> None:
        self.incl, self.phi = finite_degrees(incl, "incl"), finite_degrees(phi, "phi")
        self.posang = finite_degrees(posang, "posang")
        self.resolution = pixel_counts(resolution)
        self.width, self.center = as_given(width, "width"), as_given(center, "center")
        self.shift = as_given(shift, "shift")
        if width is not None:
            plane_size(plain(self.width, unit_of(self.width), "width"), self.resolution, "width")
        vector(self.shift, "shift", length=2)
        if center is not None:
            vector(self.center, "center")

    @classmethod
    def looking(cls, view_direction: Any, up: Any = None, **options: Any) -> Orthographic:
        """Return a camera from the direction it looks into.

        Parameters
        ----------
        view_direction : three floats
            From the camera into the scene; need not be normalised.
        up : three floats, optional
            The direction that points upwards in the image; z by default.
        **options
            ``width``, ``resolution``, ``center``, ``shift``.

        Raises
        ------
        InputError
            If the direction is zero, `up` is parallel to it, or an angle is given besides.
        """
        if angles := {"incl", "phi", "posang"} & set(options):
            raise InputError(
                "view_direction takes the place of angles, and up that of posang; leave those "
                f"out, got also {', '.join(sorted(angles))}"
            )
        incl, phi = angles_towards(-vector(view_direction, "view_direction"))
        posang = 0.0 if up is None else position_angle(incl, phi, vector(up, "up"))
        return cls(incl, phi, posang, **options)

    @classmethod
    def framing(
        cls,
        volume: Volume,
        medium: Medium | None = None,
        incl: Any = None,
        phi: Any = None,
        *,
        view: str | None = None,
        resolution: Any = 400,
    ) -> Orthographic:
        """Return a camera around the visible part of a medium.

        It is found in a coarse picture: pixels of more than 2 % of its brightest, except for 0.2 %
        of their light along each axis. They fill 0.85 of the frame. Where they fill 0.7 of a square
        frame around the whole volume, the frame is that. A picture in which they are few is drawn
        again around them, and around the brightest cells, which may be far smaller than its pixels.

        Parameters
        ----------
        volume : Volume
            Grid and fields.
        medium : Medium, optional
            Without one the frame is around the whole volume: for projections and columns.
        incl, phi, resolution
            As for `Orthographic`; see `view` for the default angles.
        view : str, optional
            In place of angles: a patient seen from ``"anterior"``, ``"posterior"``, ``"left"``,
            ``"right"``, ``"superior"`` or ``"inferior"``, with the head or the front at the top, by
            ``volume.meta["orientation"]``; ``"stack"`` for pictures above each other as ImageJ
            shows them, if ``volume.meta["y_down"]``. By default ``"anterior"`` or ``"stack"`` where
            the volume says so, else obliquely from above.

        Returns
        -------
        Orthographic
            Its ``width`` and ``shift`` are plain numbers in the volume's unit of length.

        Warns
        -----
        UserWarning
            If nothing of the medium shows: the frame is around the whole volume.

        Raises
        ------
        InputError, UnknownNameError
            As `render`; and if the volume does not say how it lies, or angles are given besides.

        Examples
        --------
        >>> import numpy as np
        >>> import voluminous as vm
        >>> density = np.zeros((16, 16, 16))
        >>> density[4:6, 8:10, 8:10] = 1
        >>> volume = vm.Volume(vm.CartesianGrid.uniform(16, (0, 16)), density=density)
        >>> medium = vm.Coefficients("density", "density")
        >>> vm.Orthographic.framing(volume, medium, 90, 0).width < 6
        True
        """
        from ..rendering.framing import framed_or_warned

        return framed_or_warned(volume, medium, incl, phi, view, resolution)[0]

    @property
    def straight(self) -> bool:
        return True

    def frame(self, grid: Grid) -> Frame:
        bounds, (nx, ny) = grid.bounds, self.resolution
        center = bounds.mean(axis=1)
        if self.center is not None:
            center = vector(on_grid(self.center, grid, "center"), "center")
        axes = image_axes(self.incl, self.phi, self.posang)
        if self.width is None:  # all corners of the domain are visible, pixels square
            corners = np.array(np.meshgrid(*bounds, indexing="ij")).reshape(3, -1).T - center
            half = np.abs(corners @ axes[:2].T).max(axis=0)
            pixel = max(2.0 * half[0] / nx, 2.0 * half[1] / ny)
            size = pixel * nx, pixel * ny
        else:
            width = on_grid(self.width, grid, "width", across=True)
            size = plane_size(width, self.resolution, "width")
        x, y = vector(on_grid(self.shift, grid, "shift"), "shift", length=2).tolist()
        return Frame(self.resolution, size, (x, y), np.stack([center, *axes[:2], -axes[2]]))

    def rays(self, vectors: list[list[Float]], u: Float, v: Float) -> Ray:
        center, ex, ey, away = vectors
        origin = [c + u * x + v * y for c, x, y in zip(center, ex, ey, strict=True)]
        return Ray(origin, list(away))

    def key(self) -> Hashable:
        return "orthographic" if type(self) is Orthographic else None

    def lines_of_sight(self, points: np.ndarray, grid: Grid) -> np.ndarray:
        away = -image_axes(self.incl, self.phi, self.posang)[2]
        return np.broadcast_to(away[:, None], np.shape(points))

    def project(self, points: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        center, *axes = self.frame(grid).vectors[:4]
        u, v, depth = np.stack(axes) @ (np.asarray(points, dtype=np.float64) - center[:, None])
        return u, v, depth

    def describe(self) -> dict[str, Any]:
        values = {"type": "orthographic", "incl": self.incl, "phi": self.phi, "posang": self.posang}
        values["resolution"] = list(self.resolution)
        if self.width is not None:
            values["width"] = described(self.width)
        if self.center is not None:
            values["center"] = described(self.center)
        if is_quantity(self.shift) or np.any(vector(self.shift, "shift", length=2)):
            values["shift"] = described(self.shift)
        return values
