"""World coordinates of a cube: its header's WCS, with axes in the order of a grid's x, y, z.

Greisen & Calabretta (2002), Calabretta & Greisen (2002), Greisen et al. (2006): FITS papers I-III.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...image.sky import of_pixels
from .blocks import Part
from .header import HINT, wcs_of

_CONVENTIONS = {"radio": "VRAD", "optical": "VOPT", "relativistic": "VELO"}
# Spectral axes are velocities where the rest frequency is known, in the convention of their kind.
_USUAL = {"FREQ": "VRAD", "ENER": "VRAD", "WAVN": "VRAD", "WAVE": "VOPT", "AWAV": "VOPT"}
# Cells that are less apart than this part of their width are the same.
_SAME = 1e-3
# Rounding of a cosine and a sine, in degrees.
_TURNED = 1e-9


@dataclass(frozen=True)
class World:
    """The world coordinates of a cube whose axes are in the order x, y, z of a grid.

    Attributes
    ----------
    wcs : astropy.wcs.WCS
        Of the arranged cube, pixel axes x, y, z.
    axes : tuple of three int
        Which axis of the cube (0 is the fastest) each is.
    flipped : tuple of three bool
        Which are reversed.
    """

    wcs: Any
    axes: tuple[int, ...]
    flipped: tuple[bool, ...]

    def arrange(self, stored: np.ndarray) -> np.ndarray:
        """Return an array in the order of NumPy as the grid wants it; a view."""
        return stored.transpose([2 - axis for axis in self.axes])[
            tuple(slice(None, None, -1 if flip else 1) for flip in self.flipped)
        ]

    @property
    def on_sky(self) -> bool:
        """True if x and y are on the celestial sphere."""
        return bool(self.wcs.has_celestial)

    def agrees(self, other: World) -> bool:
        """Return True if cells of another cube are in the same places, and in the same order."""
        if (self.axes, self.flipped) != (other.axes, other.flipped):
            return False
        ends = np.array(self.wcs.pixel_shape) - 1.0
        corners = np.array([[0.0, 0.0, 0.0], [ends[0], 0.0, ends[2]], [0.0, ends[1], 0.0]])
        try:
            found = other.wcs.wcs_world2pix(self.wcs.wcs_pix2world(corners, 0), 0)
        except ValueError:  # beyond the horizon of the other's projection
            return False
        kinds = [list(w.wcs.ctype) for w in (self.wcs, other.wcs)]
        return kinds[0] == kinds[1] and bool(np.all(np.abs(found - corners) < _SAME))

    def pointing(self) -> dict[str, Any]:
        """Return where the middle of the cube is on the sky, and how it is turned, in degrees.

        ``position_angle`` is that of the y axis, from north to east; a camera with it as its
        ``posang`` shows north at the top.
        """
        middle = 0.5 * (np.array(self.wcs.pixel_shape) - 1)
        lon, lat, _ = self.wcs.wcs_pix2world(middle[None], 0)[0]
        east, north = _linear(self.wcs)[:2, 1]
        told: dict[str, Any] = {"center": [float(lon), float(lat)]}
        angle = float(np.rad2deg(np.arctan2(east, north)))
        return told | ({"position_angle": angle} if abs(angle) > _TURNED else {})


def world(
    part: Part,
    axes: tuple[int, ...],
    sides: tuple[int, ...],
    velocity: str | None = None,
    rest: str | None = None,
) -> World:
    """Return the world coordinates of three axes of a part.

    Parameters
    ----------
    part : Part
        With the header.
    axes : tuple of three int
        The axes that are looked at; 0 is NAXIS1.
    sides : tuple of three int
        Their numbers of pixels.
    velocity, rest : str, optional
        Doppler convention, and frequency or wavelength at rest.

    Raises
    ------
    FileFormatError
        If the header contradicts itself, or axes depend on each other in a way no grid has.
    """
    wcs = wcs_of(part, rest)
    try:
        wcs = wcs.sub([axis + 1 for axis in axes])
        wcs.wcs.set()
        order = _order(wcs)
        wcs, flat = wcs.sub([k + 1 for k in order]), [sides[k] for k in order]
        _check_apart(wcs)
        wcs = _converted(wcs, velocity)
        matrix, origin, own = _upright(wcs, flat)
        wcs = of_pixels(wcs, matrix, origin, [flat[k] for k in own])
    except (ValueError, MemoryError, np.linalg.LinAlgError) as error:
        if isinstance(error, InputError):
            raise
        told = str(error).strip().splitlines()[-1]
        raise FileFormatError(f"{part.name}: its WCS cannot be used ({told}){HINT}") from error
    flipped = tuple(bool(f) for f in matrix.sum(axis=0) < 0)
    return World(wcs, tuple(order[k] for k in own), flipped)


def _order(wcs: Any) -> list[int]:
    """Return longitude, latitude and the third axis; else the spectral one last."""
    if wcs.wcs.lng >= 0 and wcs.wcs.lat >= 0:
        first = [wcs.wcs.lng, wcs.wcs.lat]
        return [*first, *({0, 1, 2} - set(first))]
    spectral = wcs.wcs.spec
    return [k for k in range(3) if k != spectral] + ([spectral] if spectral >= 0 else [])


def _linear(wcs: Any) -> np.ndarray:
    return np.asarray(np.diag(wcs.wcs.get_cdelt()) @ wcs.wcs.get_pc())


def _check_apart(wcs: Any) -> None:
    """Refuse axes that are not at right angles, except for those on the sky.

    Raises
    ------
    FileFormatError
        Naming them.
    """
    linear = np.abs(_linear(wcs))
    if not np.all(np.isfinite(linear)) or not np.all(linear.max(axis=1) > 0):
        raise FileFormatError(f"a pixel of the WCS has no size{HINT}")
    linear = linear / linear.max(axis=1, keepdims=True)
    mixed = linear - np.diag(np.diag(linear))
    if wcs.has_celestial:
        mixed[:2, :2] = 0.0
    if mixed.max() > 1e-9:
        raise FileFormatError(f"the axes of the WCS are turned (PC or CD cards){HINT}")


def _converted(wcs: Any, velocity: str | None) -> Any:
    """Return the WCS with a spectral axis that is a velocity, if that can be."""
    if velocity is not None and velocity not in _CONVENTIONS:
        raise InputError(f"velocity must be one of {list(_CONVENTIONS)}, got {velocity!r}")
    spectral = wcs.wcs.spec
    if spectral < 0:
        if velocity is not None:
            raise InputError("velocity is for spectral axes, and this cube has none")
        return wcs
    kind = wcs.wcs.ctype[spectral][:4]
    known = wcs.wcs.restfrq > 0 or wcs.wcs.restwav > 0
    if velocity is None and (kind not in _USUAL or not known):
        return wcs
    wanted = _USUAL[kind] if velocity is None else _CONVENTIONS[velocity]
    new = wcs.deepcopy()
    try:
        new.wcs.sptr(f"{wanted}-???")
    except ValueError as error:
        if velocity is None:  # a logarithmic axis, for example: as good as it is
            return wcs
        hint = "" if known else "; give rest='… GHz'"
        raise InputError(
            f"the axis {wcs.wcs.ctype[spectral]} cannot be made a {velocity} velocity{hint}"
        ) from error
    return new


def _upright(wcs: Any, sides: list[int]) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Return how pixels are exchanged and reversed so that coordinates increase, east to the left.

    Returns
    -------
    matrix, origin : arrays, shapes (3, 3) and (3,)
        Pixels of the grid are at ``matrix q + origin`` in the file.
    own : list of int
        Which axis of the file each axis of the grid is.
    """
    linear = _linear(wcs)
    own = [0, 1, 2]
    if abs(linear[0, 1] * linear[1, 0]) > abs(linear[0, 0] * linear[1, 1]):
        own = [1, 0, 2]  # turned by about 90 degrees
    signs = np.sign([linear[k, own[k]] for k in range(3)])
    for k in range(3):
        if wcs.wcs.ctype[k].endswith("-TAB"):  # the table may fall
            ends = wcs.sub([k + 1]).wcs_pix2world([[0], [sides[k] - 1]], 0)[:, 0]
            signs[k] = np.sign(ends[1] - ends[0])
    if wcs.has_celestial:
        signs[0] *= -1  # x runs to the right: to the west
    matrix, origin = np.zeros((3, 3)), np.zeros(3)
    for k in range(3):
        matrix[own[k], k] = 1.0 if signs[k] > 0 else -1.0
        origin[own[k]] = 0.0 if signs[k] > 0 else sides[own[k]] - 1.0
    return matrix, origin, own
