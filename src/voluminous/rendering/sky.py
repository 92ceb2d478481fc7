"""World coordinates of a picture: of the sky, or of a place and a velocity."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..cameras import Orthographic
from ..grids import CartesianGrid
from ..grids.axes import is_uniform
from ..image.sky import of_pixels
from ..units import parse_unit
from ..volume import Volume

# Rounding of the vectors of a camera.
_ZERO = 1e-12


def image_wcs(volume: Volume, camera: Any, frame: Any) -> Any:
    """Return the WCS of a picture; None where its plane has none.

    Parallel rays along z show the sky. Where one side of the picture is along z, it shows a
    position and what the third axis of the cube measures. Other planes mix both.
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


def _of_sky(grid: Any, wcs: Any, first: np.ndarray, steps: np.ndarray, pixels: Any) -> Any:
    """Return the celestial WCS of a picture along z."""
    if not wcs.has_celestial or not all(is_uniform(edges) for edges in grid.edges[:2]):
        return None
    width = np.array([np.ptp(edges) / (len(edges) - 1) for edges in grid.edges[:2]])
    origin = (first[:2] - grid.bounds[:2, 0]) / width - 0.5
    return of_pixels(wcs.celestial, steps[:, :2].T / width[:, None], origin, pixels)


def _of_slit(
    grid: Any, wcs: Any, frame: Any, steps: np.ndarray, first: np.ndarray, alone: list[bool]
) -> Any:
    """Return the WCS of an offset and of the third axis, to which z is proportional."""
    from astropy.wcs import WCS

    if not wcs.has_celestial and wcs.wcs.spec < 0:
        return None
    new = WCS(naxis=2)
    new.wcs.crpix = [1.0, 1.0]
    third = wcs.sub([3])
    low, high = third.wcs_pix2world([[-0.5], [grid.shape[2] - 0.5]], 0)[:, 0]
    scale = (high - low) / float(np.ptp(grid.edges[2]))
    kind = wcs.wcs.ctype[2][:4] if wcs.wcs.spec == 2 else wcs.wcs.ctype[2]
    here = low + scale * (first[2] - grid.edges[2][0])
    step = [scale * float(steps[k, 2]) if alone[k] else frame.pixel[k] for k in (0, 1)]
    new.wcs.cdelt = step
    new.wcs.crval = [here if alone[k] else float(c[0]) for k, c in enumerate(frame.coordinates())]
    new.wcs.ctype = [kind if is_third else "OFFSET" for is_third in alone]
    new.wcs.cunit = [_unit(third.wcs.cunit[0] if t else grid.unit) for t in alone]
    for name in ("restfrq", "restwav", "specsys"):
        setattr(new.wcs, name, getattr(wcs.wcs, name))
    new.pixel_shape = [int(n) for n in frame.pixels]
    new.wcs.set()
    return new


def _unit(unit: Any) -> str:
    parsed = parse_unit(unit)
    return "" if parsed is None else str(parsed.to_string("fits"))
