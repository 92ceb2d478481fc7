"""Cuts through a cube: positions along a path, and velocities."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..units import parse_unit, shown
from .image import Image
from .sky import radians_per_unit
from .spectra import on_plane
from .spectral_fits import linear

if TYPE_CHECKING:
    from astropy.wcs import WCS

    from .arguments import Axis
    from .cube import Cube

# Lines across a strip for each pixel of its width.
_FINER = 2
# Rounding of lengths, in pixels.
_ROUNDING = 1e-9


def cut(cube: Cube, points: Any, width: Any) -> Image:
    """Return a cut along a path; see `Cube.position_velocity`."""
    corners = np.array([_point(cube, point) for point in points])
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1) if len(corners) > 1 else np.zeros(0)
    if not lengths.size or not (lengths > 0).all() or not np.isfinite(lengths).all():
        raise InputError(
            f"a path needs two different places or more, (x, y) each, got {shown(points)}"
        )
    if not cube.spectral.is_even or len(cube.spectral) < 2:
        raise InputError("a cut needs two channels or more that are evenly spaced")
    step = float(np.abs(cube.pixel_size).min())
    wide = 0.0 if width is None else float(on_plane(cube, width, "width"))
    left, right, bottom, top = cube.extent
    most = abs(right - left) + abs(top - bottom)
    if not 0.0 <= wide <= most:
        raise InputError(f"width must be a positive length, at most {most:.6g}, got {shown(width)}")
    count = int(lengths.sum() / step + _ROUNDING)
    if not count:
        raise InputError(f"the path is shorter than a pixel, got {shown(points)}")
    offsets = step * (np.arange(count, dtype=np.float64) + 0.5)
    columns, rows, weights = _samples(cube, corners, lengths, offsets, wide)
    values = _weighted(cube, columns, rows, weights, len(offsets))
    if np.isnan(values).all() and not np.isnan(cube.intensity).all():
        raise InputError(f"the path does not meet the cube, got {shown(points)}")
    wcs = _wcs(cube, step, (len(offsets), cube.channels))
    how = {"path": corners.tolist(), "width": wide, "unit": cube.unit}
    return Image(
        values.T,
        intensity_unit=cube.intensity_unit,
        wcs=wcs,
        camera=cube.camera,
        provenance={**(cube.provenance or {}), "cut": how},
    )


def _point(cube: Cube, point: Any) -> list[float]:
    try:
        x, y = point
    except (TypeError, ValueError):
        raise InputError(f"a place on a path is (x, y), got {shown(point)}") from None
    return [float(on_plane(cube, x, "x")), float(on_plane(cube, y, "y"))]


def _samples(
    cube: Cube, corners: np.ndarray, lengths: Axis, offsets: Axis, wide: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pixels around each sample of the path, (offset, sample), and their weights."""
    ends = np.cumsum(lengths)
    part = np.minimum(np.searchsorted(ends, offsets * (1 - _ROUNDING)), len(lengths) - 1)
    direction = (np.diff(corners, axis=0) / lengths[:, None])[part]
    places = corners[part] + (offsets - (ends - lengths)[part])[:, None] * direction
    step = 2.0 * offsets[0]  # offsets are in the middle of steps
    count = max(1, int(np.ceil(_FINER * wide / step)))
    aside = wide * ((np.arange(count) + 0.5) / count - 0.5)
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=-1)
    samples = places[:, None, :] + aside[:, None] * normal[:, None, :]
    # Linear between the four pixels around each sample; none beyond the middle of the outermost.
    last = [max(len(axis) - 1, 1) for axis in (cube.x, cube.y)]
    sizes = [
        (axis[-1] - axis[0]) / n or side
        for axis, n, side in zip((cube.x, cube.y), last, cube.pixel_size, strict=True)
    ]
    at = (samples - [cube.x[0], cube.y[0]]) / sizes
    low = np.floor(at + _ROUNDING).astype(int)
    alongs = np.moveaxis(np.maximum(at - low, 0.0), -1, 0)
    columns, rows, weights = [], [], []
    for right in (0, 1):
        for up in (0, 1):
            columns.append(low[..., 0] + right)
            rows.append(low[..., 1] + up)
            shares = [a if side else 1.0 - a for a, side in zip(alongs, (right, up), strict=True)]
            weights.append(shares[0] * shares[1])
    joined = (np.concatenate(parts, axis=-1) for parts in (columns, rows, weights))
    return tuple(joined)  # type: ignore[return-value]


def _weighted(
    cube: Cube, columns: np.ndarray, rows: np.ndarray, weights: np.ndarray, count: int
) -> np.ndarray:
    """Return means of the spectra of pixels, (offset, channel); NaN where all are outside."""
    from scipy.sparse import csr_matrix

    ny, nx, _ = cube.shape
    inside = (columns >= 0) & (columns < nx) & (rows >= 0) & (rows < ny) & (weights > _ROUNDING)
    offset = np.broadcast_to(np.arange(count)[:, None], inside.shape)[inside]
    pixels, number = np.unique(rows[inside] * nx + columns[inside], return_inverse=True)
    matrix = csr_matrix((weights[inside], (offset, number)), shape=(count, len(pixels)))
    spectra = cube.intensity[pixels // nx, pixels % nx].astype(np.float64)
    with np.errstate(invalid="ignore"):
        return np.asarray((matrix @ spectra) / np.asarray(matrix.sum(axis=1)))


def _wcs(cube: Cube, step: float, shape: tuple[int, int]) -> WCS:
    """Return world coordinates as pvextractor's: OFFSET from the first point, and the spectrum."""
    from astropy import units as u
    from astropy.wcs import WCS

    scale, unit = radians_per_unit(cube), parse_unit(cube.unit)
    if scale is not None:
        step, unit = float(np.rad2deg(scale * step) * 3600.0), u.arcsec
    kind, spectral_unit, reference, spacing = linear(cube.spectral)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crpix = ["OFFSET", kind], [0.5, 1.0]  # the path begins at an edge
    wcs.wcs.crval, wcs.wcs.cdelt = [0.0, reference], [step, spacing]
    wcs.wcs.cunit = ["" if unit is None else unit.to_string("fits"), spectral_unit]
    wcs.wcs.restfrq, wcs.wcs.specsys = cube.spectral.rest or 0.0, cube.spectral.frame
    wcs.pixel_shape = shape
    wcs.wcs.set()
    return wcs
