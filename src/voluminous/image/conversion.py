"""Units and beams of images: lengths on the plane, intensities per beam, pixel or channel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import InputError, UnitsError
from ..units import degrees, parse_unit, plain, unit_of
from .arguments import Array, known_unit
from .cube import Cube
from .sky import plane_factor, radians_per_unit

if TYPE_CHECKING:
    from astropy import units as u

    from ..units import UnitLike
    from .image import Image, Own

# Rows of a cube are treated together up to so many numbers: what is made on the way stays small.
_TOGETHER = 2**20


def to_unit(image: Own, unit: UnitLike, beam: Any = None) -> Own:
    """Return the image in another unit; see `Image.to`."""
    target, on_plane = parse_unit(unit), known_unit(image.unit)
    known = on_plane is not None and target is not None
    if known and (scale := plane_factor(image, on_plane, target)) is not None:
        width, height = image.pixel_size
        size = (scale * width, scale * height)
        x, y = scale * image.x, scale * image.y
        image = image.replace(unit=str(target), x=x, y=y, pixel_size=size)
        present = known_unit(image.intensity_unit)
        if present is None or not present.is_equivalent(
            target
        ):  # else a map of depths: convert both
            return image
    present = parse_unit(image.intensity_unit)
    if present is None:
        plane_unit = f", and its plane is in {image.unit}" if image.unit else ""
        raise UnitsError(
            f"the image's intensities have no unit{plane_unit}, so there is no {unit}; "
            "give Image(..., intensity_unit=, unit=), or emissivities with units (vm.Coefficients)"
        )
    factor = conversion(image, present, target, beam)
    scaled = {
        name: _scaled(plane, factor)
        for name in ("intensity", "lower", "upper")
        if (plane := image.plane(name)) is not None
    }
    if image.error is not None:  # a fraction of the largest intensity, in every channel
        both = (image.intensity, scaled["intensity"])
        largest = [max(np.nanmax(values), -np.nanmin(values)) for values in both]
        same = np.ndim(factor) == 0 or not 0 < largest[0] < np.inf
        factor = np.max(factor) if same else largest[1] / largest[0]
        scaled["error"] = _scaled(image.error, factor)
    return image.replace(intensity_unit=target, **scaled)


def rows_of(cube: Image) -> Iterator[slice]:
    """Return slices of a few rows each, which cover the picture."""
    ny, nx, count = cube.shape
    step = max(1, _TOGETHER // (nx * count))
    return (slice(first, min(first + step, ny)) for first in range(0, ny, step))


def _scaled(values: Array, factor: Any) -> Array:
    info = np.finfo(values.dtype)
    result = np.empty(values.shape, values.dtype)
    parts = max(1, values.size // _TOGETHER)
    for old, new in zip(np.array_split(values, parts), np.array_split(result, parts), strict=True):
        wide = old.astype(np.float64) * factor
        before, after = np.abs(old), np.abs(wide)
        lost = before >= info.tiny
        lost &= after < info.tiny
        lost |= (before <= info.max) & (after > info.max)
        if lost.any() and values.dtype != np.float64:
            return np.asarray(values * np.asarray(factor, np.float64), np.float64)
        new[...] = wide
    return result


def conversion(image: Image, present: Any, target: Any, beam: Any = None) -> Any:
    """Return the factor from one unit to another, with solid angles of beams and pixels.

    Of a cube it may differ between channels: brightness temperatures by the law of Rayleigh and
    Jeans, T = c² I / (2 k ν²), as radio astronomers define them, and what is per wavelength.
    """
    from astropy import units as u

    target = u.dimensionless_unscaled if target is None else target
    if beam is not None and u.beam not in (*present.decompose().bases, *target.decompose().bases):
        raise UnitsError(
            f"beam= is for units per beam, but it is from {present} to {target}: leave it out"
        )
    if present.is_equivalent(target):  # both units are per beam, or neither is
        return float(present.to(target))
    angles: Any = 1.0
    message = f"intensities in {present} cannot be converted to {target or 'no unit'}"
    for base, area in ((u.beam, _beam_area), (u.pix, _pixel_area)):
        powers = []
        for unit in (present, target):
            plain = unit.decompose()
            powers.append(float(dict(zip(plain.bases, plain.powers, strict=True)).get(base, 0.0)))
        if any(powers):
            angles = angles * area(image, beam) ** (powers[0] - powers[1])  # beams may differ
            present, target = (
                x * (u.sr / base) ** power
                for x, power in zip((present, target), powers, strict=True)
            )
    if present.is_equivalent(target):
        return angles * float((present / target).to(u.dimensionless_unscaled))
    if target.is_equivalent(u.rad) and not present.is_equivalent(u.rad):
        raise UnitsError(
            f"{message}, nor lengths on the image plane: say how far it is with "
            "image.replace(distance=140 * u.pc)"
        )
    if not isinstance(image, Cube):
        hint = "a beam or a pixel is a solid angle, and leads from Jy / sr to Jy / beam"
        if target.is_equivalent(u.K):
            hint = "a temperature needs the frequency of each channel: see vm.Cube"
        raise UnitsError(f"{message}: {hint}")
    nu = image.spectral.frequencies * u.Hz
    laws = u.brightness_temperature(nu) + u.spectral_density(nu)
    try:
        factor = present.to(target, np.ones(len(nu)), equivalencies=laws)
        return np.asarray(angles * factor, np.float64)
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{message}: a beam or a pixel is a solid angle, and leads from Jy / sr to Jy / beam"
        ) from error


def _beam_area(image: Image, beam: Any) -> Any:
    """Return the solid angle in sr of `beam`, or else of the beam in the image's provenance."""
    known = (image.provenance or {}).get("beam") if beam is None else beam
    if known is None:
        raise UnitsError("per beam needs to know which: give beam=, or convolve the image first")
    return beam_area(image, as_beam(known))


def _pixel_area(image: Image, beam: Any) -> float:
    to_sky = angle_matrix(image)
    if to_sky is None:
        raise UnitsError(
            "per pixel needs to know the pixels' solid angle: say how far the image is with "
            "image.replace(distance=140 * u.pc), or image.on_sky(distance=, position=)"
        )
    return abs(float(np.linalg.det(to_sky))) * float(np.deg2rad(1.0)) ** 2


# Ratio of a Gaussian's standard deviation to its full width at half maximum.
SIGMA = 1.0 / math.sqrt(8.0 * math.log(2.0))
# Radius of the kernel in standard deviations; 4e-7 of the Gaussian lies outside.
_REACH = 5.5
# Maximum full width in sides of the image: the size of a kernel grows with the square.
_WIDEST = 2.0
# Least full width in pixels, and what rounding does to it.
_NARROWEST = 1.0 - 1e-6
# Beams narrower than this (standard deviation in pixels) are averaged over each pixel.
_NARROW, _FINER = 2.0, 10
# Channels that are convolved together.
_CHANNELS = 8
# Minimum fraction of the kernel on valid pixels; below it a pixel is missing (rounding: 1e-16).
_LEAST = 1e-6


class Beam(NamedTuple):
    """Full widths at half maximum, position angle in degrees, and the unit of the widths.

    Of a cube whose channels have beams of their own these are arrays.
    """

    major: Any
    minor: Any
    pa: Any
    unit: u.UnitBase | None


def convolve(image: Own, beam: Any) -> Own:
    """Return the image convolved with a beam; see `Image.convolve`."""
    how = image.provenance or {}
    kind = str(how.get("map", how.get("kind", "mean" if "weight" in how else "column")))
    if kind.split()[0] not in ("column", "integrated"):  # or "column of …"
        raise InputError(
            f"a map of the {kind} cannot be convolved: its numbers do not add up. Convolve "
            "columns, such as those of a weight and of what is weighted, and divide"
        )
    if "beam" in how:
        known = "a beam for each channel" if has_beams(image) else how["beam"]
        raise InputError(f"the image was convolved before, with {known}")
    beam = as_beam(beam)
    covariance = _in_pixels(image, beam)
    narrow, wide = np.sqrt(np.linalg.eigvalsh(covariance)) / SIGMA
    widest = wide / max(image.shape[:2])
    if not widest <= _WIDEST:
        raise InputError(
            f"the beam is {widest:.3g} times as wide as the image, expected at most {_WIDEST:g}; "
            "check its unit, or make a picture of a wider frame"
        )
    if not narrow >= _NARROWEST:
        more = math.ceil(max(image.shape[:2]) / narrow)
        raise InputError(
            f"the beam is {narrow:.3g} pixels wide, so the picture cannot show it; expected one "
            f"pixel at least: check its unit, or draw more pixels, such as resolution={more}"
        )
    kernel = _kernel(covariance)
    names = ("intensity", "transparency", "error", "lower", "upper")
    planes = {name: image.plane(name) for name in names}
    smooth = {name: _smoothed(p, kernel) for name, p in planes.items() if p is not None}
    beam = _of_plane(image, beam)
    described = {**beam._asdict(), "unit": str(beam.unit or "")}
    # A mean over the beam has no optical depth.
    return image.replace(optical_depth=None, provenance={**how, "beam": described}, **smooth)


def _of_plane(image: Image, beam: Beam) -> Beam:
    """Return a beam in the unit of a plane that is not on the sky yet.

    Its angle is from up to the left, which need not be from north to east later.
    """
    plane_unit = parse_unit(image.unit)
    if beam.unit is None or plane_unit is None or sky_matrix(image) is not None:
        return beam
    factor = plane_factor(image, beam.unit, plane_unit)
    return (
        beam
        if factor is None
        else Beam(factor * beam.major, factor * beam.minor, beam.pa, plane_unit)
    )


def as_beam(beam: Any) -> Beam:
    """Return a beam from what a user gave, or from its description in the provenance.

    That is a width, (major, minor), (major, minor, pa), or a radio_beam.Beam.
    """
    if hasattr(beam, "major") and hasattr(beam, "minor"):
        beam = (beam.major, beam.minor, beam.pa)
    if isinstance(beam, dict) and set(beam) >= set(Beam._fields):
        beam = {n: np.array(v) if isinstance(v, list) else v for n, v in beam.items()}
        return Beam(**{**beam, "unit": parse_unit(beam["unit"])})
    parts = list(beam) if isinstance(beam, (tuple, list)) or np.ndim(beam) > 0 else [beam]
    if not 1 <= len(parts) <= 3 or any(np.ndim(part) > 0 for part in parts):
        raise InputError(f"beam must be a width or (major, minor, pa), got {beam!r}")
    unit = unit_of(parts[0])
    minor, *_, major = sorted(float(plain(w, unit, "beam")) for w in (parts[:2] * 2)[:2])
    angle = degrees(parts[2], "the beam's position angle") if len(parts) == 3 else 0.0
    if not (0.0 < minor <= major < math.inf and math.isfinite(angle)):
        raise InputError(f"the widths of a beam must be positive and finite, got {beam!r}")
    return Beam(major, minor, angle, unit)


def has_beams(image: Image) -> bool:
    """Return True if each channel has a beam of its own."""
    return np.ndim(((image.provenance or {}).get("beam") or {}).get("major", 0.0)) > 0


def beam_area(image: Image, beam: Beam) -> Any:
    """Return the solid angle of a beam on the sky in steradians, 2π σ₁ σ₂; of beams an array."""
    unit = beam.unit
    if unit is not None and unit.is_equivalent("rad"):
        return 2.0 * np.pi * (SIGMA * unit.to("rad")) ** 2 * beam.major * beam.minor
    to_sky = angle_matrix(image)
    if to_sky is None:
        raise UnitsError(
            "the beam's solid angle is not known: give its width as an angle such as "
            "0.5 * u.arcsec, or say how far the image is: image.replace(distance=140 * u.pc), or "
            "image.on_sky(distance=, position=)"
        )
    on_sky = to_sky @ _in_pixels(image, beam) @ to_sky.T
    return float(2.0 * np.pi * math.sqrt(np.linalg.det(on_sky)) * np.deg2rad(1.0) ** 2)


def fits_beam(image: Image) -> tuple[float, float, float] | None:
    """Return BMAJ, BMIN and BPA in degrees of the beam of a convolved image on the sky."""
    known, to_sky = (image.provenance or {}).get("beam"), angle_matrix(image)
    if known is None or to_sky is None or has_beams(image):
        return None
    covariance = to_sky @ _in_pixels(image, as_beam(known)) @ to_sky.T
    (minor, major), axes = np.linalg.eigh(covariance)
    east, north = axes[:, 1]
    angle = np.rad2deg(np.arctan2(east, north)) % 180.0
    return math.sqrt(major) / SIGMA, math.sqrt(minor) / SIGMA, float(angle)


def beam_in_pixels(image: Image) -> np.ndarray | None:
    """Return the covariance in pixels of the beam that an image was convolved with, if any."""
    known = (image.provenance or {}).get("beam")
    return None if known is None or has_beams(image) else _in_pixels(image, as_beam(known))


def sky_matrix(image: Image) -> np.ndarray | None:
    """Return the matrix from pixels to degrees east and north; None without celestial axes."""
    if image.wcs is None or not image.wcs.has_celestial:
        return None
    return np.asarray(image.wcs.celestial.pixel_scale_matrix, dtype=np.float64)


def angle_matrix(image: Image) -> np.ndarray | None:
    """Return the matrix from pixels to degrees left and up; None if a pixel has no known angle.

    On the sky left and up are east and north (`sky_matrix`).
    """
    scale = radians_per_unit(image)
    if (to_sky := sky_matrix(image)) is not None or scale is None or image.wcs is not None:
        return to_sky
    return np.diag(np.rad2deg(scale * np.array(image.pixel_size)) * [-1.0, 1.0])


def _in_pixels(image: Image, beam: Beam) -> np.ndarray:
    """Return the covariance of a beam in pixels along x and y.

    Position angles run from north to east on the sky, and from up to the left on a plane.
    """
    plane_unit, to_sky, unit = parse_unit(image.unit), sky_matrix(image), beam.unit
    is_angle = unit is not None and unit.is_equivalent("rad")
    if unit is not None and is_angle and to_sky is not None:
        to_plane, scale = to_sky, float(unit.to("deg"))
    else:
        to_plane = np.diag(np.array(image.pixel_size) * [-1.0, 1.0])
        there = None if plane_unit is None else plane_factor(image, unit or plane_unit, plane_unit)
        if there is None and unit is not None:
            advice = "; say how far it is: image.replace(distance=140 * u.pc)"
            raise UnitsError(
                f"the beam is in {unit}, the image's plane in {image.unit or 'no unit'}"
                + advice * is_angle
            )
        scale = 1.0 if there is None else there
    factor = SIGMA * scale
    c, s = math.cos(math.radians(beam.pa)), math.sin(math.radians(beam.pa))
    axes = np.array([[s, c], [c, -s]]).T * (factor * np.array([beam.major, beam.minor]))
    from_plane = np.linalg.inv(to_plane) @ axes
    return np.asarray(from_plane @ from_plane.T)


def _kernel(covariance: np.ndarray) -> Any:
    from astropy.convolution import Gaussian2DKernel

    (minor, major), axes = np.linalg.eigh(covariance)
    angle = math.atan2(axes[1, 1], axes[0, 1])
    sigmas = [math.sqrt(v) for v in (major, minor)]
    reach = [2 * math.ceil(_REACH * math.sqrt(v) + 0.5) + 1 for v in np.diag(covariance)]
    fine = {"mode": "oversample", "factor": _FINER} if sigmas[1] < _NARROW else {}
    return Gaussian2DKernel(*sigmas, theta=angle, x_size=reach[0], y_size=reach[1], **fine)


def _smoothed(planes: np.ndarray, kernel: Any) -> np.ndarray:
    """Return the planes convolved with zeros beyond the edges, a few channels at a time.

    Missing pixels (NaN) are interpolated from their surroundings within the kernel's radius.
    """
    from astropy.convolution import convolve_fft
    from scipy.signal import fftconvolve

    weights = np.asarray(kernel.array / kernel.array.sum(), np.float64)[..., None]
    channels, result = np.atleast_3d(planes), np.empty_like(planes)
    smooth = np.atleast_3d(result)  # a view
    for first in range(0, channels.shape[-1], _CHANNELS):
        some = slice(first, first + _CHANNELS)
        block = channels[..., some].astype(np.float64)
        if np.isfinite(block).all():
            block = fftconvolve(block, weights, mode="same", axes=(0, 1))
        else:
            # astropy treats NaN as missing and renormalises the rest of the kernel there.
            options = {"boundary": "fill", "allow_huge": True, "min_wt": _LEAST}
            block = np.stack(
                [convolve_fft(plane, kernel, **options) for plane in np.moveaxis(block, -1, 0)], -1
            )
        if not np.any(channels[..., some] < 0.0):
            np.maximum(block, 0.0, out=block)  # rounding of the FFT can make values negative
        smooth[..., some] = block
    return result
