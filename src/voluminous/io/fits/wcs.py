"""The WCS of a cube: repaired, and with axes in the grid's order x, y, z.

Greisen & Calabretta (2002), Calabretta & Greisen (2002), Greisen et al. (2006): FITS papers I-III.
Axes with tabulated coordinates (``-TAB`` of paper III, section 6, and SKIRT's) become a ``-TAB``
axis with one coordinate per pixel and no index.
"""

from __future__ import annotations

import re
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError, VoluminousError
from ...image.sky import of_pixels, table_hdus
from .cubes import FITSImage, card, opened, text
from .units import fits_name, lenient_unit

if TYPE_CHECKING:
    from astropy.io.fits import HDUList, Header
    from astropy.wcs import WCS

_SKIRT = "Z-AXIS COORDINATE VALUES"
_TABLE, _COLUMN = "VOLTABLE", "CENTERS"
_KINDS = {"length": "WAVE", "frequency": "FREQ", "energy": "ENER"}
# Non-standard spellings and their standard form.
_TYPES = {
    "VELOCITY": "VELO",
    "VELOCIT": "VELO",
    "FREQUENC": "FREQ",
    "FREQUENCY": "FREQ",
    "LAMBDA": "WAVE",
    "WAVELENG": "WAVE",
    "WAVELENGTH": "WAVE",
}
_CONVENTIONS = {"radio": "VRAD", "optical": "VOPT", "relativistic": "VELO"}
# With a rest frequency, spectral axes become velocities in the convention of their type.
_USUAL = {"FREQ": "VRAD", "ENER": "VRAD", "WAVN": "VRAD", "WAVE": "VOPT", "AWAV": "VOPT"}
# CD1_2, and the pre-standard form PC001002.
_MATRIX = re.compile(r"(CD|PC)0*(\d+?)(?:_|0+)(\d+)")
# Advice for an invalid header.
HINT = "; open it with wcs=False for cells of unit length, or with bounds=…"


def has_world(header: Header) -> bool:
    """Return True if a header contains world coordinates."""
    keys = ("CDELT", "CTYPE", "CRVAL", "CD", "PC")
    return any(f"{key}{end}" in header for key in keys for end in ("1", "2", "1_1", "001001"))


def world(
    image: FITSImage, axes: tuple[int, ...], velocity: str | None, rest: Any
) -> tuple[WCS, tuple[int, ...], tuple[bool, ...]]:
    """Return the WCS of three axes of an image, as x, y, z of the grid.

    Also the axis (of the three) for each of x, y and z, and whether it is reversed.
    """
    from astropy.wcs import WCS

    if velocity is not None and velocity not in _CONVENTIONS:
        raise InputError(f"velocity must be one of {list(_CONVENTIONS)}, got {velocity!r}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            header = _mended(image, rest)
            wcs = WCS(header, _put_tables(image, header))
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
            raise FileFormatError(f"{image}: its WCS cannot be used ({reason}){HINT}") from error
    flipped = tuple(bool(f) for f in matrix.sum(axis=0) < 0)
    return wcs, tuple(order[k] for k in own), flipped


def _mended(image: FITSImage, rest: Any) -> Header:
    from astropy import units as u

    header = image.header.copy()
    count = max(int(card(header, "WCSAXES", 0)), len(image.shape))
    for k in range(1, count + 1):
        unit = str(card(header, f"CUNIT{k}", "")).strip()
        if unit:
            header[f"CUNIT{k}"] = fits_name(lenient_unit(unit))
        kind = text(header, f"CTYPE{k}")
        if kind in _TYPES:
            header[f"CTYPE{k}"] = _TYPES[kind]
    _put_one_matrix(header, count, len(image.shape))
    if rest is not None:
        for key in ("RESTFRQ", "RESTFREQ", "RESTWAV"):
            header.remove(key, ignore_missing=True)
        try:
            header["RESTFRQ"] = float(u.Quantity(rest).to_value(u.Hz, u.spectral()))
        except (TypeError, ValueError) as error:
            raise InputError(
                f"rest must be a frequency or wavelength such as '110.2 GHz', got {rest!r}"
            ) from error
    return header


def _put_one_matrix(header: Header, count: int, pixels: int) -> None:
    """Describe all axes with CDi_j cards if some axes have them.

    wcslib accepts one form for all axes and assumes steps of 1 for axes given in another.
    """
    cards = {key: match for key in header if (match := _MATRIX.fullmatch(key))}
    values = {(m[1], int(m[2]), int(m[3])): float(card(header, key)) for key, m in cards.items()}
    by_matrix = {i for (kind, i, _), value in values.items() if kind == "CD" and value}
    axes = range(1, count + 1)
    rows = {}
    for i in axes if by_matrix else ():
        step = float(card(header, f"CDELT{i}", 0.0 if i <= pixels else 1.0))
        own = [step * values.get(("PC", i, j), float(i == j)) for j in axes]
        rows[i] = [values.get(("CD", i, j), 0.0) for j in axes] if i in by_matrix else own
        if i not in by_matrix and (not any(own) or card(header, f"CROTA{i}", 0.0)):
            raise ValueError(f"CDELT{i} is missing, or CROTA{i} beside CD cards of others")
    for key, match in cards.items():
        if by_matrix or (match[1] == "CD" and "CDELT1" in header):  # all zero: no information
            del header[key]
    for i, row in rows.items():
        header.remove(f"CROTA{i}", ignore_missing=True)
        header[f"CDELT{i}"] = 1.0
        for j, value in zip(axes, row, strict=True):
            if value:
                header[f"CD{i}_{j}"] = value


def _put_tables(image: FITSImage, header: Header) -> HDUList | None:
    """Give axes with tabulated coordinates one per pixel; return the HDUs that hold them."""
    from astropy.io import fits
    from astropy.wcs import WCS

    tabled = [k for k in range(len(image.shape)) if text(header, f"CTYPE{k + 1}").endswith("-TAB")]
    if not tabled and len(image.shape) != 3:
        return None
    with opened(image.path) as hdus:
        skirt = next((hdu for hdu in hdus if hdu.name == _SKIRT), None)
        if skirt is not None and 2 not in tabled:
            column = skirt.columns[0]
            unit = lenient_unit(column.unit or str(card(header, "CUNIT3", "")))
            kinds = (k for m, k in _KINDS.items() if unit is not None and unit.physical_type == m)
            header["CTYPE3"], header["CUNIT3"] = next(kinds, "ZVAL") + "-TAB", fits_name(unit)
            centers = {2: np.asarray(skirt.data.field(0), np.float64)}
        else:
            wcs: Any = WCS(header, hdus) if tabled else None
            centers = {
                k: wcs.sub([k + 1]).wcs_pix2world(np.arange(image.shape[k])[:, None], 0)[:, 0]
                for k in tabled
            }
    tables = [_put_centers(header, k, values) for k, values in centers.items()]
    return fits.HDUList([fits.PrimaryHDU(), *tables]) if tables else None


def _put_centers(header: Header, axis: int, centers: np.ndarray) -> Any:
    """Assign pixel coordinates to an axis (from 0) of a header; return their table."""
    k, steps = axis + 1, np.diff(centers)
    count = header[f"NAXIS{k}"]
    if centers.shape != (count,) or not (np.all(steps > 0) or np.all(steps < 0)):
        raise ValueError(f"the table of axis {k} has not {count} coordinates that rise or fall")
    for key in [key for key in header if key.startswith((f"CD{k}_", f"PC{k}_", f"PS{k}_"))]:
        del header[key]
    header.remove(f"CROTA{k}", ignore_missing=True)
    for key in ("CRPIX", "CRVAL", "CDELT"):
        header[f"{key}{k}"] = 1.0
    header[f"PS{k}_0"], header[f"PS{k}_1"] = f"{_TABLE}{k}", _COLUMN
    header[f"PV{k}_1"] = header[f"PV{k}_2"] = header[f"PV{k}_3"] = 1.0
    return table_hdus({(f"{_TABLE}{k}", _COLUMN): centers})[0]


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
    """Return the WCS with its spectral axis converted to velocity, if possible."""
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
    linear, own = linear_part(wcs), [0, 1, 2]
    if abs(linear[0, 1] * linear[1, 0]) > abs(linear[0, 0] * linear[1, 1]):
        own = [1, 0, 2]  # rotated by about 90 degrees
    signs = np.sign(linear[[0, 1, 2], own])
    for k in range(3):
        if wcs.wcs.ctype[k].endswith("-TAB"):  # the table may descend
            ends = wcs.sub([k + 1]).wcs_pix2world([[0], [sides[k] - 1]], 0)[:, 0]
            signs[k] = np.sign(ends[1] - ends[0])
    if wcs.has_celestial:
        signs[0] *= -1  # x runs to the right, which is west
    matrix, origin = np.zeros((3, 3)), np.zeros(3)
    matrix[own, [0, 1, 2]] = np.where(signs > 0, 1.0, -1.0)
    origin[own] = np.where(signs > 0, 0.0, np.array(sides)[own] - 1.0)
    return matrix, origin, own
