"""World coordinates of a picture: of the sky, or of a position and a velocity."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..cameras import Orthographic
from ..geometry import is_uniform
from ..grids.cartesian.grid import CartesianGrid
from ..image.sky import of_pixels
from ..units import parse_unit
from ..volume import Volume

if TYPE_CHECKING:
    from ..cameras.contract import Camera, Frame

# Rounding of the vectors of a camera.
_ZERO = 1e-12


def image_wcs(volume: Volume, camera: Camera, frame: Frame) -> Any:
    """Return the WCS of a picture; None where its plane has none.

    For parallel rays along z the WCS is that of the sky. Where one side of the picture is along z,
    its axes are a position and the third axis of the cube. Other planes mix both.
    """
    grid, wcs = volume.grid, volume.wcs
    if not isinstance(camera, Orthographic) or not isinstance(grid, CartesianGrid):
        return None
    if wcs is None or tuple(wcs.pixel_shape or ()) != grid.shape:
        return None
    center, *sides = frame.vectors[:3]
    first = center + sum(c[0] * side for c, side in zip(frame.coordinates(), sides, strict=True))
    steps = np.array([step * side for step, side in zip(frame.pixel, sides, strict=True)])
    along = [abs(side[2]) > _ZERO for side in sides]
    if not any(along):
        return _of_sky(grid, wcs, first, steps, frame.pixels)
    alone = [abs(abs(side[2]) - 1.0) < _ZERO for side in sides]
    return _of_slit(grid, wcs, frame, steps, first, alone) if any(alone) else None


def _of_sky(
    grid: CartesianGrid, wcs: Any, first: np.ndarray, steps: np.ndarray, pixels: Any
) -> Any:
    if not wcs.has_celestial or not all(is_uniform(edges) for edges in grid.edges[:2]):
        return None
    width = np.array([np.ptp(edges) / (len(edges) - 1) for edges in grid.edges[:2]])
    origin = (first[:2] - grid.bounds[:2, 0]) / width - 0.5
    return of_pixels(wcs.celestial, steps[:, :2].T / width[:, None], origin, pixels)


def _of_slit(
    grid: CartesianGrid,
    wcs: Any,
    frame: Frame,
    steps: np.ndarray,
    first: np.ndarray,
    alone: list[bool],
) -> Any:
    from astropy.wcs import WCS

    if not wcs.has_celestial and wcs.wcs.spec < 0:
        return None
    single, walls = wcs.sub([3]), grid.edges[2]
    low, high = single.wcs_pix2world([[-0.5], [grid.shape[2] - 0.5]], 0)[:, 0]
    scale = float((high - low) / np.ptp(walls))
    # The type in which z is linear, not the one in which channels are equidistant.
    kind = wcs.wcs.ctype[2][:4] if wcs.wcs.spec == 2 else wcs.wcs.ctype[2]
    third = kind, single.wcs.cunit[0], float(low + scale * (first[2] - walls[0]))
    # Type, unit, value at the first pixel and step of each side of the picture.
    sides = [
        (*third, scale * float(steps[k, 2]))
        if alone[k]
        else ("OFFSET", grid.unit, float(frame.coordinates()[k][0]), frame.pixel[k])
        for k in (0, 1)
    ]
    new = WCS(naxis=2)
    new.wcs.crpix = [1.0, 1.0]
    new.wcs.ctype, units, new.wcs.crval, new.wcs.cdelt = (list(s) for s in zip(*sides, strict=True))
    parsed = map(parse_unit, units)
    new.wcs.cunit = ["" if unit is None else str(unit.to_string("fits")) for unit in parsed]
    for name in ("restfrq", "restwav", "specsys"):
        setattr(new.wcs, name, getattr(wcs.wcs, name))
    new.pixel_shape = [int(n) for n in frame.pixels]
    new.wcs.set()
    return new
