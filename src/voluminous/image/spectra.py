"""Along the channels of a cube: moments, the continuum, channel maps, and spectra.

A few rows of pixels are treated at a time, so that no second cube is held in memory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, UnitsError, check_flag
from ..units import is_count, parse_unit, plain, shown, unit_of
from .conversion import conversion, has_beams, rows_of
from .image import Image
from .sky import plane_factor, radians_per_unit
from .spectral_axis import linear
from .spectrum import Spectrum

if TYPE_CHECKING:
    from astropy.wcs import WCS

    from .arguments import Array, Axis
    from .cube import Cube

_VELOCITY = "km / s"
# Names of the moments, for colour bars.
_MAPS = ("integrated intensity", "velocity", "velocity dispersion")
# At most so many channel maps are drawn unless a number is given.
_MAPS_DRAWN = 24
# The purest red and blue are so many standard deviations from the middle of a spectrum.
_REACH = 1.5
# Arguments of `Image` that a picture made from a cube shares with it.
_PLACE = ("x", "y", "unit", "pixel_size", "wcs", "distance", "camera", "provenance")


def image_of(cube: Cube, values: Array, unit: Any, **how: Any) -> Image:
    """Return a picture with the pixels of a cube; `how` is added to the provenance."""
    same = {name: getattr(cube, name) for name in _PLACE}
    same["provenance"] = {**_of_several(cube), **how}
    return Image(values, intensity_unit="" if unit is None else str(unit), **same)


def _of_several(cube: Cube) -> dict[str, Any]:
    """Return the provenance of what is made of several channels: their beams are not its beam."""
    how = cube.provenance or {}
    return {name: value for name, value in how.items() if name != "beam" or not has_beams(cube)}


def moment(cube: Cube, order: int, threshold: Any = None) -> Image:
    """Return a moment; see `Cube.moment`."""
    if type(order) not in (int, np.int64) or order not in (0, 1, 2):
        raise InputError(f"the order of a moment is 0, 1 or 2, got {order!r}")
    velocities, widths = cube.spectral.velocities, _widths(cube)
    # Close to the middle of the band, differences lose no digits.
    middle = 0.5 * (velocities[0] + velocities[-1])
    powers = widths[:, None] * (velocities[:, None] - middle) ** np.arange(order + 1)
    faintest = -np.inf if threshold is None else _least(cube, threshold)
    values = np.empty(cube.shape[:2])
    for rows in rows_of(cube):
        block = cube.intensity[rows].astype(np.float64)
        there = block >= faintest  # false for NaN
        block[~there] = 0.0
        sums = block.reshape(-1, cube.channels) @ powers
        total, *higher = sums.T.reshape(-1, *block.shape[:2])
        with np.errstate(divide="ignore", invalid="ignore"):
            if order == 0:
                values[rows] = np.where(there.any(axis=-1), total, np.nan)
                continue
            mean = higher[0] / total
            values[rows] = middle + mean if order == 1 else np.sqrt(higher[1] / total - mean**2)
    if order:
        values[~np.isfinite(values)] = np.nan
        return image_of(cube, values, _VELOCITY, map=_MAPS[order])
    present, velocity = parse_unit(cube.intensity_unit), parse_unit(_VELOCITY)
    return image_of(cube, values, velocity if present is None else present * velocity, map=_MAPS[0])


def _least(cube: Cube, threshold: Any) -> float:
    least = plain(threshold, parse_unit(cube.intensity_unit), "threshold")
    if not isinstance(least, float) or np.isnan(least):
        raise InputError(f"threshold must be one intensity, got {shown(threshold)}")
    return least


def _widths(cube: Cube) -> Axis:
    """Return the width of each channel in km/s: to the middle between it and its neighbours."""
    velocities = cube.spectral.velocities
    steps = np.diff(velocities)
    if not len(steps) or not ((steps > 0).all() or (steps < 0).all()):
        raise InputError(
            f"moments need two channels or more with rising or falling velocities, got "
            f"{cube.spectral!r}"
        )
    sides = np.abs(np.concatenate([steps[:1], steps, steps[-1:]]))
    return np.asarray(0.5 * (sides[1:] + sides[:-1]))


def subtract_continuum(cube: Cube, channels: Any, order: int) -> Cube:
    """Return the cube without its continuum; see `Cube.subtract_continuum`."""
    if type(order) not in (int, np.int64) or order not in (0, 1):
        raise InputError(f"order must be 0 (a mean) or 1 (a straight line), got {order!r}")
    free = _chosen(cube.channels, channels)
    if len(free) <= order:
        raise InputError(f"a continuum of order {order} needs more channels than {len(free)}")
    places = cube.spectral.values
    scaled = (places - places.mean()) / (np.ptp(places) or 1.0)
    powers = scaled[:, None] ** np.arange(order + 1)
    fit = np.linalg.pinv(powers[free]).T  # least squares
    values = np.empty_like(cube.intensity)
    for rows in rows_of(cube):
        block = cube.intensity[rows].astype(np.float64)
        block -= (block[..., free] @ fit) @ powers.T
        values[rows] = block
    return cube.replace(intensity=values, lower=None, upper=None)


def _chosen(count: int, channels: Any) -> np.ndarray:
    """Return numbers of channels: of slices, a mask, or numbers; by default a tenth at each end."""
    if channels is None:
        part = max(1, count // 10)
        return np.unique(np.r_[0:part, count - part : count])
    every = np.arange(count)
    parts = channels if isinstance(channels, (list, tuple)) else [channels]
    try:
        if not any(isinstance(part, slice) for part in parts):
            parts = [np.asarray(channels)]
        free = np.unique(np.concatenate([np.atleast_1d(every[part]) for part in parts]))
    except (IndexError, ValueError, TypeError) as error:
        raise InputError(
            f"channels must be slices, a mask or numbers of the {count} channels, got "
            f"{shown(channels)}: {error}"
        ) from error
    return free


def in_colors(cube: Cube) -> Image:
    """Return a picture of three channels; see `Cube.in_colors`."""
    axis, bright = cube.spectral, np.nan_to_num(np.abs(_sums(cube)), posinf=0.0)
    places = axis.velocities if axis.kind == "velocity" else np.log(axis.wavelengths)
    bright = bright if bright.sum() > 0 else np.ones(cube.channels)
    middle = np.average(places, weights=bright)
    reach = _REACH * np.sqrt(np.average((places - middle) ** 2, weights=bright)) or 1.0
    red = np.clip((places - middle) / reach, -1.0, 1.0)
    colors = np.stack([np.maximum(red, 0.0), 1.0 - np.abs(red), np.maximum(-red, 0.0)], axis=-1)
    share = bright @ colors / bright.sum()
    colors /= np.where(share > 0.0, share, 1.0)  # what all shines together is grey
    values = np.empty((*cube.shape[:2], 3), cube.intensity.dtype)
    for rows in rows_of(cube):
        values[rows] = np.nan_to_num(cube.intensity[rows].astype(np.float64)) @ colors
    transparency = cube.plane("transparency")
    if transparency is not None:
        transparency = transparency.mean(axis=-1)
    return image_of(cube, values, parse_unit(cube.intensity_unit)).replace(
        transparency=transparency
    )


def channel_maps(cube: Cube, count: int | None) -> Cube:
    """Return means of neighbouring channels; see `Cube.channel_maps`."""
    if count is not None and not is_count(count, 2**31):
        raise InputError(f"the number of maps must be a positive whole number, got {count!r}")
    most = _MAPS_DRAWN if count is None else int(count)
    if most >= cube.channels:
        return cube
    size = cube.channels // (most + 1) + 1  # the least that makes no more maps
    groups = cube.channels // size
    first = (cube.channels - groups * size) // 2
    used = slice(first, first + groups * size)
    values = np.empty((*cube.shape[:2], groups), cube.intensity.dtype)
    for rows in rows_of(cube):
        block = cube.intensity[rows, :, used]
        values[rows] = block.reshape(*block.shape[:2], groups, size).mean(-1, dtype=np.float64)
    axis = cube.spectral
    middle = axis.values[used].reshape(groups, size).mean(axis=1)
    return cube.replace(
        intensity=values,
        spectral=axis.replace(values=middle, unit=axis.unit),
        provenance=_of_several(cube),
        transparency=None,
        optical_depth=None,
        lower=None,
        upper=None,
    )


def spectrum_at(cube: Cube, x: Any, y: Any, pixel: bool) -> Spectrum:
    """Return the spectrum of one pixel; see `Cube.spectrum_at`."""
    check_flag("pixel", pixel)
    if pixel:
        column, row = (plain(value, None, name) for value, name in ((x, "x"), (y, "y")))
    else:
        column, row = (_nearest(cube, value, axis) for axis, value in enumerate((x, y)))
    ny, nx, _ = cube.shape
    if np.ndim(column) or np.ndim(row):
        raise InputError(f"x and y are one number each, got {shown(x)} and {shown(y)}")
    if not (0 <= column < nx and 0 <= row < ny and int(column) == column and int(row) == row):
        raise InputError(
            f"there is no pixel at ({shown(x)}, {shown(y)}): the cube has {nx} x {ny} pixels, from "
            f"{_edges(cube)}"
        )
    pixels = [int(column), int(row)]
    return Spectrum(
        cube.spectral,
        cube.intensity[pixels[1], pixels[0]],
        unit=cube.intensity_unit,
        distance=cube.distance,
        provenance={**(cube.provenance or {}), "pixel": pixels},
    )


def _nearest(cube: Cube, value: Any, axis: int) -> int:
    """Return the number of the pixel at a place along x or y; -1 for none."""
    centers, side = (cube.x, cube.y)[axis], cube.pixel_size[axis]
    away = np.abs(centers - on_plane(cube, value, "xy"[axis]))
    # Half a pixel, and rounding.
    return int(away.argmin()) if away.min() <= 0.500001 * abs(side) else -1


def on_plane(cube: Cube, value: Any, what: str) -> Any:
    """Return a place along x or y in the unit of the image plane, also of an angle."""
    given, plane_unit = unit_of(value), parse_unit(cube.unit)
    factor = None if given is None or plane_unit is None else plane_factor(cube, given, plane_unit)
    found = plain(value, plane_unit, what) if factor is None else factor * plain(value, given, what)
    if np.ndim(found):
        raise InputError(f"{what} must be one number, got {shown(value)}")
    return found


def _edges(cube: Cube) -> str:
    left, right, bottom, top = cube.extent
    return f"x = {left:.6g} … {right:.6g}, y = {bottom:.6g} … {top:.6g} {cube.unit}".rstrip()


def total(cube: Cube, beam: Any = None) -> Spectrum:
    """Return the flux of all pixels together; see `Cube.total`."""
    present = parse_unit(cube.intensity_unit)
    if present is None:
        raise UnitsError("a flux needs intensities with a unit: cube.replace(intensity_unit=…)")
    factor = conversion(cube, present, parse_unit("Jy / pix"), beam)
    return Spectrum(
        cube.spectral,
        _sums(cube) * factor,
        unit="Jy",
        distance=cube.distance,
        provenance=cube.provenance,
    )


def _sums(cube: Cube) -> Axis:
    """Return the sum over all pixels in each channel; missing ones count as zero."""
    sums = np.zeros(cube.channels)
    for rows in rows_of(cube):
        sums += np.nansum(cube.intensity[rows], axis=(0, 1), dtype=np.float64)
    return sums


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
