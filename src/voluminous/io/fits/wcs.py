"""The WCS of a cube, with axes in the grid's order x, y, z."""

from __future__ import annotations

import functools
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError, VoluminousError
from ...image.fits_header import world_of
from ...image.sky import of_pixels
from .cubes import FITSImage, opened

if TYPE_CHECKING:
    from astropy.io.fits import Header
    from astropy.wcs import WCS

_CONVENTIONS = {"radio": "VRAD", "optical": "VOPT", "relativistic": "VELO"}
# With a rest frequency, spectral axes become velocities in the convention of their type.
_USUAL = {"FREQ": "VRAD", "ENER": "VRAD", "WAVN": "VRAD", "WAVE": "VOPT", "AWAV": "VOPT"}
# Advice for an invalid header.
HINT = "; open it with wcs=False for cells of unit length, or with bounds=…"


def has_world(header: Header) -> bool:
    """Return True if a header contains world coordinates."""
    keys = ("CDELT", "CTYPE", "CRVAL", "CD", "PC")
    return any(f"{key}{end}" in header for key in keys for end in ("1", "2", "1_1", "001001"))


def world(
    image: FITSImage, axes: tuple[int, ...], velocity: str | None, rest: Any
) -> tuple[WCS, Header, tuple[int, ...], tuple[bool, ...]]:
    """Return the WCS of three axes of an image, as x, y, z of the grid.

    Also the header as it is meant, the axis (of the three) for each of x, y and z, and whether it
    is reversed.
    """
    if velocity is not None and velocity not in _CONVENTIONS:
        raise InputError(f"velocity must be one of {list(_CONVENTIONS)}, got {velocity!r}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            opening = functools.partial(opened, image.path)
            wcs, header = world_of(image.header, image.shape, opening, rest)
            # Not of three axes, and not to be turned.
            wcs.sip = wcs.cpdis1 = wcs.cpdis2 = wcs.det2im1 = wcs.det2im2 = None
            wcs = wcs.sub([axis + 1 for axis in axes])
            wcs.wcs.set()
            order = _order(wcs)
            wcs = wcs.sub([k + 1 for k in order])
            sides = [image.shape[axes[k]] for k in order]
            _check_apart(wcs)
            wcs = _converted(wcs, velocity)
            matrix, origin, own = _upright(wcs, sides)
            wcs = of_pixels(wcs, matrix, origin, [sides[k] for k in own])
        except VoluminousError:
            raise
        except Exception as error:  # wcslib and astropy raise many exception types
            reason = str(error).strip().splitlines()[-1]
            hint = "; give rest='… GHz'" if "rest freq" in reason else HINT
            raise FileFormatError(f"{image}: its WCS cannot be used ({reason}){hint}") from error
    flipped = tuple(bool(f) for f in matrix.sum(axis=0) < 0)
    return wcs, header, tuple(order[k] for k in own), flipped


def _order(wcs: WCS) -> list[int]:
    """Return the axes as longitude, latitude, third; without a sky, with the spectral axis last."""
    if wcs.wcs.lng >= 0 and wcs.wcs.lat >= 0:
        first = [wcs.wcs.lng, wcs.wcs.lat]
        return [*first, *({0, 1, 2} - set(first))]
    return sorted(range(3), key=lambda k: k == wcs.wcs.spec)


def linear_part(wcs: WCS) -> np.ndarray:
    """Return the matrix from pixels to the projection plane."""
    return np.asarray(np.diag(wcs.wcs.get_cdelt()) @ wcs.wcs.get_pc())


def _check_apart(wcs: WCS) -> None:
    linear = np.abs(linear_part(wcs))
    if not np.all(np.isfinite(linear)) or not np.all(linear.max(axis=1) > 0):
        raise ValueError("a pixel has no size")
    mixed = linear / linear.max(axis=1, keepdims=True) * (1 - np.eye(3))
    if wcs.has_celestial:
        mixed[:2, :2] = 0.0
    if mixed.max() > 1e-9:
        raise ValueError("its axes are turned by PC or CD cards")


def _converted(wcs: WCS, velocity: str | None) -> WCS:
    spectral = wcs.wcs.spec
    if spectral < 0:
        if velocity is not None:
            raise InputError("velocity is for spectral axes, and this cube has none")
        return wcs
    kind = wcs.wcs.ctype[spectral][:4]
    known = wcs.wcs.restfrq > 0 or wcs.wcs.restwav > 0
    if velocity is None and (kind not in _USUAL or not known):
        return wcs
    new = wcs.deepcopy()
    try:
        new.wcs.sptr(f"{_USUAL[kind] if velocity is None else _CONVENTIONS[velocity]}-???")
    except ValueError as error:
        if velocity is None:  # for example a logarithmic axis: keep it unchanged
            return wcs
        hint = "" if known else "; give rest='… GHz'"
        raise InputError(
            f"the axis {wcs.wcs.ctype[spectral]} cannot be made a {velocity} velocity{hint}"
        ) from error
    return new


def _upright(wcs: WCS, sides: list[int]) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Return how to swap and reverse pixel axes so that coordinates ascend, with east to the left.

    Grid pixel q lies at ``matrix q + origin`` in the file, with axes in the order returned last.
    """
    linear, order = linear_part(wcs), [0, 1, 2]
    if abs(linear[0, 1] * linear[1, 0]) > abs(linear[0, 0] * linear[1, 1]):
        order = [1, 0, 2]  # rotated by about 90 degrees
    signs = np.sign(linear[[0, 1, 2], order])
    for k in range(3):
        if wcs.wcs.ctype[k].endswith("-TAB"):  # the table may descend
            ends = wcs.sub([k + 1]).wcs_pix2world([[0], [sides[k] - 1]], 0)[:, 0]
            signs[k] = np.sign(ends[1] - ends[0])
    if wcs.has_celestial:
        signs[0] *= -1  # x runs to the right, which is west
    matrix, origin = np.zeros((3, 3)), np.zeros(3)
    matrix[order, [0, 1, 2]] = np.where(signs > 0, 1.0, -1.0)
    origin[order] = np.where(signs > 0, 0.0, np.array(sides)[order] - 1.0)
    return matrix, origin, order
