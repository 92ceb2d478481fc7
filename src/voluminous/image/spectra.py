"""Along the channels of a cube: moments, the continuum, channel maps, and spectra.

A few rows of pixels are treated at a time, so that no second cube is held in memory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, UnitsError, check_flag
from ..units import is_count, parse_unit, plain, shown, unit_of
from .beam import has_beams
from .conversion import conversion, rows_of
from .image import Image
from .sky import plane_factor
from .spectrum import Spectrum

if TYPE_CHECKING:
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
