"""World coordinates: WCS of images, plot axes (astropy's WCSAxes), and positions on the sky."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, UnitsError
from ..units import degrees, parse_unit, plain
from .arguments import known_unit
from .cube import Cube

if TYPE_CHECKING:
    from astropy.coordinates import SkyCoord
    from astropy.wcs import WCS
    from matplotlib.axes import Axes

    from .image import Image, Own


def of_pixels(wcs: WCS, matrix: Any, origin: Any, shape: Any) -> Any:
    """Return the WCS of new pixels q that lie at ``matrix q + origin`` in the pixels of `wcs`.

    The centre of the first pixel is 0; `matrix` (n, n) is not singular; `shape` has n numbers of
    new pixels. Only the linear transformation from pixels to the projection plane changes: Greisen
    & Calabretta (2002), "Representations of world coordinates in FITS", eq. 9.
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    new = wcs.deepcopy()
    linear = np.diag(wcs.wcs.get_cdelt()) @ wcs.wcs.get_pc() @ matrix
    # Pixel size along each world axis, with the sign of the diagonal element.
    steps = np.linalg.norm(linear, axis=1) * np.where(np.diag(linear) < 0, -1.0, 1.0)
    if wcs.wcs.has_cd():
        del new.wcs.cd
    new.wcs.pc, new.wcs.cdelt = linear / steps[:, None], steps
    reference = np.linalg.solve(matrix, wcs.wcs.crpix - 1.0 - np.asarray(origin, np.float64))
    new.wcs.crpix = reference + 1.0
    new.pixel_shape = [int(n) for n in shape]
    new.wcs.set()
    return new


def tables_of(wcs: WCS) -> dict[tuple[str, str], np.ndarray]:
    """Return the coordinate tables of a WCS (``-TAB``), by names of table and column."""
    texts = {(axis, m): text for axis, m, text in wcs.wcs.get_ps()}
    axes = [(int(table.map[0]) + 1, np.ravel(table.coord)) for table in wcs.wcs.tab]
    return {(texts[axis, 0], texts[axis, 1]): centers for axis, centers in axes}


def table_hdus(tables: Mapping[tuple[str, str], np.ndarray]) -> list[Any]:
    """Return the tables of `tables_of` as HDUs."""
    from astropy.io import fits

    hdus = []
    for (name, title), values in tables.items():
        n = len(values)
        column = fits.Column(title, f"{n}D", dim=f"(1,{n})", array=np.reshape(values, (1, n, 1)))
        hdus.append(fits.BinTableHDU.from_columns([column], name=name))
    return hdus


_NAMES = {
    "RA": "right ascension",
    "DEC": "declination",
    "GLON": "galactic longitude",
    "GLAT": "galactic latitude",
    "ELON": "ecliptic longitude",
    "ELAT": "ecliptic latitude",
    "VRAD": "velocity (radio)",
    "VOPT": "velocity (optical)",
    "VELO": "velocity",
    "FREQ": "frequency",
    "WAVE": "wavelength",
    "AWAV": "wavelength (air)",
    "OFFSET": "offset",
}
# Units that replace the SI units of a WCS on axes.
_READ = ("km/s", "GHz", "um")
# Approximate number of ticks on an axis.
_TICKS = 8


def is_sky_axes(axes: Axes) -> bool:
    """Return True for axes with world coordinates (WCSAxes)."""
    return hasattr(axes, "coords") and hasattr(axes, "wcs")


def label_axes(axes: Any, wcs: WCS) -> None:
    """Name both coordinates, and choose their units."""
    (left, right, bottom, top), labels = plain_axes(wcs)
    for number, (low, high) in enumerate(((left, right), (bottom, top))):
        coordinate, unit = axes.coords[number], _unit(wcs, number)
        coordinate.set_axislabel(labels[number])
        if coordinate.coord_type == "scalar" and unit is not None:
            coordinate.set_format_unit(unit)
            # By default astropy takes the decimals from the unit of the WCS. A format like "%.0f"
            # makes it drop the common prefix of labels: it shows -1000 and -500 as -1000 and 500.
            # Its "x.x" format, with matplotlib's minus sign, avoids both.
            decimals = max(0, -math.floor(math.log10(abs(high - low) / _TICKS)))
            coordinate.set_major_formatter(f"x.{'x' * decimals}".removesuffix("."))


def plain_axes(wcs: WCS) -> tuple[tuple[float, float, float, float], list[str]]:
    """Return edges (left, right, bottom, top) and labels of linear coordinates."""
    corners = np.array([[-0.5, -0.5], np.array(wcs.pixel_shape) - 0.5])
    ends, labels = wcs.wcs_pix2world(corners, 0).T, []
    for number in (0, 1):
        unit, kind = _unit(wcs, number), str(wcs.wcs.ctype[number])
        name = _NAMES.get(kind.split("-")[0], kind.lower())
        labels.append(name if unit is None or wcs.has_celestial else f"{name} [{unit}]")
        ends[number] *= 1.0 if unit is None else float(wcs.wcs.cunit[number].to(unit))
    (left, right), (bottom, top) = ends.tolist()
    return (left, right, bottom, top), labels


def is_linear(wcs: WCS) -> bool:
    """Return True for independent, linear coordinates."""
    straight = np.array_equal(wcs.wcs.get_pc(), np.eye(2))
    return bool(straight and not any("-" in kind for kind in wcs.wcs.ctype))


def has_lengths(wcs: WCS) -> bool:
    """Return True if a scale bar along x can represent a length: x is on the sky."""
    return bool(wcs.has_celestial or wcs.wcs.ctype[0] == "OFFSET")


def _unit(wcs: WCS, number: int) -> Any:
    unit = parse_unit(wcs.wcs.cunit[number])
    if unit is None or unit.si.scale != 1:  # a unit outside the SI is a deliberate choice
        return unit
    known = (parse_unit(name) for name in _READ)
    return next((u for u in known if unit.is_equivalent(u)), unit)


# Name of celestial coordinates whose origin is arbitrary.
OFFSETS = "offsets"
# Tolerance for uniform pixel spacing, in pixels: a header stores only one pixel size.
_EVEN_TO = 1e-6


def on_sky(image: Own, distance: Any, position: Any, posang: Any) -> Own:
    """Return the image with celestial world coordinates; see `Image.on_sky`."""
    from astropy.wcs.utils import celestial_frame_to_wcs

    scale, projection = _plane(image, distance)
    steps = np.array(image.pixel_size) * scale
    reference = []
    for centres, step in zip((image.x, image.y), image.pixel_size, strict=True):
        even = centres[0] + step * np.arange(centres.size)
        if np.abs(even - centres).max() > _EVEN_TO * abs(step):
            raise InputError("the pixels of this picture are not evenly spaced, as FITS needs them")
        reference.append(1.0 - centres[0] / step)
    center = as_position(position)
    try:
        wcs = celestial_frame_to_wcs(center.frame, projection=projection)
    except ValueError:  # FITS has no name for this frame
        center = center.icrs
        wcs = celestial_frame_to_wcs(center.frame, projection=projection)
    sphere = center.spherical
    wcs.wcs.crval = [sphere.lon.wrap_at("360d").deg, sphere.lat.deg]
    wcs.wcs.crpix = reference
    # East is on the left: right ascension increases towards negative x.
    wcs.wcs.cdelt = np.rad2deg([-steps[0], steps[1]])
    # Up is north rotated towards east. The angle applies to lengths: pixels may not be square.
    angle = np.deg2rad(_finite(degrees(posang, "posang"), "posang"))
    c, s, ratio = np.cos(angle), np.sin(angle), steps[1] / steps[0]
    wcs.wcs.pc = [[c, -s * ratio], [s / ratio, c]]
    wcs.pixel_shape = (image.shape[1], image.shape[0])
    wcs.wcs.set()
    unit = known_unit(image.unit)
    if distance is None or unit is None:
        return image.replace(wcs=wcs)
    return image.replace(wcs=wcs, distance=float(unit.to("cm")) / scale)


def offsets(image: Image) -> WCS | None:
    """Return coordinates for a file: offsets on the sky from the origin of a distant image's plane.

    Programs such as CASA, CARTA and spectral-cube want a right ascension and a declination; both
    are 0 at the origin. None without a `distance` (or angles of a cube), or for uneven pixels.
    """
    if radians_per_unit(image) is None or (image.distance is None and not isinstance(image, Cube)):
        return None
    try:
        wcs = on_sky(image, None, (0.0, 0.0), 0.0).wcs
    except InputError:
        return None
    assert wcs is not None
    wcs.wcs.name = OFFSETS
    return wcs


def _plane(image: Image, distance: Any) -> tuple[float, str]:
    """Return radians per unit of the image plane at its centre, and the projection's name.

    For a perspective camera the plane is a screen at unit distance, or a dome. For parallel rays
    the plane passes through the object, which makes it a screen at the object's distance.
    """
    unit = parse_unit(image.unit)
    if unit is not None and unit.is_equivalent("rad"):
        if distance is not None:
            raise InputError(
                f"this picture's plane is measured in {image.unit}, so it has no distance; "
                "leave distance= out"
            )
        dome = (image.camera or {}).get("projection") == "spherical"
        return float(unit.to("rad")), "ARC" if dome else "TAN"
    if distance is None and (scale := radians_per_unit(image)) is not None:
        return scale, "TAN"
    if distance is None:
        raise InputError(
            "a picture on the sky needs distance=, such as 140 * u.pc, and position= of its origin"
        )
    try:
        length = plain(distance, unit, "distance")
    except UnitsError as error:
        raise UnitsError(
            f"distance must be a length such as 140 * u.pc, got {distance!r}; the picture's plane "
            f"is in {image.unit or 'no unit'}"
        ) from error
    if not isinstance(length, float) or not 0.0 < length < np.inf:
        raise InputError(f"distance must be positive and finite, got {distance!r}")
    return 1.0 / length, "TAN"


def radians_per_unit(image: Image) -> float | None:
    """Return radians per unit of the image plane, by its distance; None if it is not known."""
    unit = known_unit(image.unit)
    return None if unit is None else plane_factor(image, unit, parse_unit("rad"))


def plane_factor(image: Image, unit: Any, other: Any) -> float | None:
    """Return the factor from a unit to another, from lengths to angles by the image's distance.

    None if there is none.
    """
    if unit.is_equivalent(other):
        return float(unit.to(other))
    if image.distance is not None and unit.is_equivalent("cm") and other.is_equivalent("rad"):
        return float(unit.to("cm") / image.distance / other.to("rad"))
    if image.distance is not None and unit.is_equivalent("rad") and other.is_equivalent("cm"):
        return float(unit.to("rad") * image.distance / other.to("cm"))
    return None


def as_position(position: Any) -> SkyCoord:
    """Return a position on the sky (SkyCoord, (ra, dec) or text) as a scalar SkyCoord.

    Plain numbers are degrees, texts such as ``"05h35m17.3s -05d23m28s"``; both ICRS.
    """
    from astropy.coordinates import SkyCoord

    if position is None:
        raise InputError(
            "a picture on the sky needs position= of its origin: a SkyCoord or (ra, dec) in degrees"
        )
    try:
        if isinstance(position, (SkyCoord, str)):
            center = SkyCoord(position)
        else:
            ra, dec = (_finite(degrees(angle, "position"), "position") for angle in position)
            center = SkyCoord(ra, dec, unit="deg")
        if center.isscalar:
            _finite(center.spherical.lon.deg + center.spherical.lat.deg, "position")
    except (ValueError, TypeError, UnitsError) as error:
        raise InputError(
            f"position must be a SkyCoord, (ra, dec) in degrees or a text such as "
            f"'05h35m17.3s -05d23m28s', got {position!r}: {error}"
        ) from error
    if not center.isscalar:
        raise InputError(f"position must be one place on the sky, got {center.shape} of them")
    return center


def _finite(angle: float, what: str) -> float:
    if not np.isfinite(angle):
        raise InputError(f"{what} must be finite, got {angle} degrees")
    return angle
