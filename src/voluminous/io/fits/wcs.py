"""World coordinates of a cube: its repaired WCS, with axes in the grid's order x, y, z.

Greisen & Calabretta (2002), Calabretta & Greisen (2002), Greisen et al. (2006): FITS papers I-III.
Axes with tabulated coordinates (``-TAB`` of paper III, section 6, and SKIRT's) become a ``-TAB``
axis with one coordinate per pixel and no index.
"""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...image.sky import of_pixels, table_hdus
from .hdus import HDU, card, image_shape, is_compressed, number
from .units import fits_name, lenient_unit

if TYPE_CHECKING:
    from astropy.io.fits import Header
    from astropy.wcs import WCS

_SKIRT = "Z-AXIS COORDINATE VALUES"
_TABLE, _COLUMN = "VOLTABLE", "CENTERS"
_KINDS = {"length": "WAVE", "frequency": "FREQ", "energy": "ENER"}


def skirt_centers(part: HDU, header: Header) -> dict[int, np.ndarray]:
    """Return ``{2: coordinates}`` if the file has SKIRT's table of the third axis, else ``{}``.

    Also sets the type and unit of the axis in the header.
    """
    from astropy.io import fits

    if header.get("NAXIS") != 3 or str(card(header, "CTYPE3", "")).strip().endswith("-TAB"):
        return {}
    with fits.open(part.path, memmap=False) as hdus:
        table = next((hdu for hdu in hdus if hdu.name == _SKIRT), None)
        if table is None:
            return {}
        if len(table.columns) != 1:
            raise FileFormatError(f"{_SKIRT} has {len(table.columns)} columns, expected one")
        centers = np.asarray(table.data.field(0), np.float64)
        unit = lenient_unit(table.columns[0].unit or str(card(header, "CUNIT3", "")))
    kinds = (k for m, k in _KINDS.items() if unit is not None and unit.physical_type == m)
    header["CTYPE3"], header["CUNIT3"] = next(kinds, "ZVAL") + "-TAB", fits_name(unit)
    return {2: centers}


def put_centers(header: Header, axis: int, centers: np.ndarray) -> Any:
    """Assign pixel coordinates to an axis (from 0) of a header; return their table."""
    k, steps = axis + 1, np.diff(centers)
    count = header[f"NAXIS{k}"]
    if centers.shape != (count,) or not (np.all(steps > 0) or np.all(steps < 0)):
        raise FileFormatError(
            f"the coordinates of axis {k} in a table are {centers}, expected {count} that rise or "
            "fall"
        )
    for key in [key for key in header if key.startswith((f"CD{k}_", f"PC{k}_", f"PS{k}_"))]:
        del header[key]
    header.remove(f"CROTA{k}", ignore_missing=True)
    for key in ("CRPIX", "CRVAL", "CDELT"):
        header[f"{key}{k}"] = 1.0
    header[f"PS{k}_0"], header[f"PS{k}_1"] = f"{_TABLE}{k}", _COLUMN
    header[f"PV{k}_1"] = header[f"PV{k}_2"] = header[f"PV{k}_3"] = 1.0
    return table_hdus({(f"{_TABLE}{k}", _COLUMN): centers})[0]


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
# CD1_2, and the pre-standard form PC001002.
_CARD = re.compile(r"(CD|PC)(\d\d?_\d\d?|\d{6})")
# Maximum that fits into the keyword names of the standard.
_MOST_AXES = 99
# Advice for an invalid header.
HINT = "; open it with wcs=False for cells of unit length, or with bounds=…"


def has_world(part: HDU) -> bool:
    """Return True if a header contains world coordinates."""
    keys = ("CDELT", "CTYPE", "CRVAL", "CD", "PC")
    return any(f"{key}{end}" in part.header for key in keys for end in ("1", "2", "1_1", "001001"))


def wcs_of(part: HDU, rest: str | None) -> WCS:
    """Return the WCS of a header after correcting common misspellings."""
    from astropy.io import fits
    from astropy.wcs import WCS

    sides = image_shape(part)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        header = _mended(part, rest)
        kinds = [str(card(header, f"CTYPE{k + 1}", "")).strip() for k in range(len(sides))]
        tabled = [k for k, kind in enumerate(kinds) if kind.endswith("-TAB")]
        try:
            centers = skirt_centers(part, header)
            if tabled:
                with fits.open(part.path, memmap=False) as hdus:
                    wcs = WCS(header, hdus)
                for k in tabled:
                    pixels = np.arange(sides[k])[:, None]
                    centers[k] = wcs.sub([k + 1]).wcs_pix2world(pixels, 0)[:, 0]
            tables = [put_centers(header, k, values) for k, values in centers.items()]
            _put_one_matrix(part, header)
            wcs = WCS(header, fits.HDUList([fits.PrimaryHDU(), *tables]) if tables else None)
        except FileFormatError:
            raise
        except Exception as error:  # wcslib and astropy raise many exception types
            told = str(error).strip().splitlines()[-1]
            raise FileFormatError(f"{part.name}: its WCS is wrong ({told}){HINT}") from error
    # Not of three axes, and not to be turned.
    wcs.sip = wcs.cpdis1 = wcs.cpdis2 = wcs.det2im1 = wcs.det2im2 = None
    return wcs


def _mended(part: HDU, rest: str | None) -> Header:
    header = part.header.copy()
    if is_compressed(part):  # a table's axes, not an image's
        for k, side in enumerate(image_shape(part), start=1):
            header[f"NAXIS{k}"] = side
        header["NAXIS"] = len(image_shape(part))
    count = max(part.whole("WCSAXES", 0), len(image_shape(part)))
    if count > _MOST_AXES:
        raise FileFormatError(f"{part.name}: a WCS of {count} axes, expected {_MOST_AXES} at most")
    for k in range(1, count + 1):
        unit = str(card(header, f"CUNIT{k}", "")).strip()
        if unit:
            header[f"CUNIT{k}"] = fits_name(lenient_unit(unit))
        kind = str(card(header, f"CTYPE{k}", "")).strip().upper()
        if kind in _TYPES:
            header[f"CTYPE{k}"] = _TYPES[kind]
    if rest is not None:
        _put_rest(header, rest)
    return header


def _put_one_matrix(part: HDU, header: Header) -> None:
    """Describe all axes with CDi_j cards if some axes have them.

    wcslib accepts one form for all axes and assumes steps of 1 for axes given in another.
    """
    cards = {}
    for found in filter(None, map(_CARD.fullmatch, header)):
        ends = found[2].split("_") if "_" in found[2] else (found[2][:3], found[2][3:])
        cards[found[1], int(ends[0]), int(ends[1])] = found[0]
    values = {place: number(part, key, 0.0) for place, key in cards.items()}
    sides = image_shape(part)
    axes = range(1, max(part.whole("WCSAXES", 0), len(sides)) + 1)
    by_matrix = {i for (kind, i, _), value in values.items() if kind == "CD" and value}
    if not by_matrix:
        for key in cards.values() if "CDELT1" in header else ():
            if key.startswith("CD"):  # all zero: no information
                del header[key]
        return
    rows = {}
    for i in axes:
        own = [values.get(("CD", i, j), 0.0) for j in axes]
        by_steps = any(kind == "PC" and k == i for kind, k, _ in values)
        step = number(part, f"CDELT{i}", 0.0)
        turn = [step * values.get(("PC", i, j), float(i == j)) for j in axes]
        if i not in by_matrix:
            if not by_steps and number(part, f"CROTA{i}", 0.0):
                raise FileFormatError(f"{part.name}: CROTA{i} beside CD cards of others{HINT}")
            if not any(turn) and (i > len(sides) or sides[i - 1] == 1):
                turn[i - 1] = 1.0
            if not any(turn):
                raise FileFormatError(f"{part.name}: there is no CD{i}_{i} or CDELT{i}{HINT}")
        elif by_steps and any(
            not math.isclose(a, b, rel_tol=1e-6) for a, b in zip(own, turn, strict=True)
        ):
            raise FileFormatError(f"{part.name}: CD{i}_j and PC{i}_j contradict each other{HINT}")
        rows[i] = own if i in by_matrix else turn
    for key in cards.values():
        del header[key]
    for i, row in rows.items():
        header.remove(f"CROTA{i}", ignore_missing=True)
        header[f"CDELT{i}"] = 1.0
        for j, value in zip(axes, row, strict=True):
            if value:
                header[f"CD{i}_{j}"] = value


def _put_rest(header: Header, rest: Any) -> None:
    from astropy import units as u

    for key in ("RESTFRQ", "RESTFREQ", "RESTWAV"):
        header.remove(key, ignore_missing=True)
    try:
        value = u.Quantity(rest)
        header["RESTFRQ"] = float(value.to_value(u.Hz, u.spectral()))
    except (TypeError, ValueError) as error:
        raise InputError(
            f"rest must be a frequency or wavelength such as '110.2 GHz', got {rest!r}"
        ) from error


_CONVENTIONS = {"radio": "VRAD", "optical": "VOPT", "relativistic": "VELO"}
# With a rest frequency, spectral axes become velocities in the convention of their type.
_USUAL = {"FREQ": "VRAD", "ENER": "VRAD", "WAVN": "VRAD", "WAVE": "VOPT", "AWAV": "VOPT"}
# Cells offset by less than this fraction of their width are identical.
_SAME = 1e-3
# Rounding error of a cosine and a sine, in degrees.
_TURNED = 1e-9


@dataclass(frozen=True)
class World:
    """The world coordinates of a cube whose axes are in the grid's order x, y, z."""

    wcs: WCS  # of the rearranged cube, pixel axes x, y, z
    axes: tuple[int, ...]  # axis of the cube (0 is the fastest) for each of x, y, z
    flipped: tuple[bool, ...]  # whether each axis is reversed

    def arrange(self, stored: np.ndarray) -> np.ndarray:
        """Return a view of a NumPy-ordered array in the grid's axis order."""
        return stored.transpose([2 - axis for axis in self.axes])[
            tuple(slice(None, None, -1 if flip else 1) for flip in self.flipped)
        ]

    @property
    def on_sky(self) -> bool:
        """True if x and y are on the celestial sphere."""
        return bool(self.wcs.has_celestial)

    def agrees(self, other: World) -> bool:
        """Return True if another cube has the same cells in the same order."""
        if (self.axes, self.flipped) != (other.axes, other.flipped):
            return False
        ends = np.array(self.wcs.pixel_shape) - 1.0
        corners = np.array([[0.0, 0.0, 0.0], [ends[0], 0.0, ends[2]], [0.0, ends[1], 0.0]])
        try:
            found = other.wcs.wcs_world2pix(self.wcs.wcs_pix2world(corners, 0), 0)
        except ValueError:  # outside the other cube's projection
            return False
        kinds = [list(w.wcs.ctype) for w in (self.wcs, other.wcs)]
        return kinds[0] == kinds[1] and bool(np.all(np.abs(found - corners) < _SAME))

    def pointing(self) -> dict[str, Any]:
        """Return the sky position of the cube's centre and its orientation, in degrees.

        ``posang`` is the position angle of the y axis, from north to east; a camera with the same
        ``posang`` shows north at the top.
        """
        middle = 0.5 * (np.array(self.wcs.pixel_shape) - 1)
        lon, lat, _ = self.wcs.wcs_pix2world(middle[None], 0)[0]
        east, north = _linear(self.wcs)[:2, 1]
        told: dict[str, Any] = {"center": [float(lon), float(lat)]}
        angle = float(np.rad2deg(np.arctan2(east, north)))
        return told | ({"posang": angle} if abs(angle) > _TURNED else {})


def world(
    part: HDU,
    axes: tuple[int, ...],
    sides: tuple[int, ...],
    velocity: str | None = None,
    rest: str | None = None,
) -> World:
    """Return the world coordinates of three axes of a part."""
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


def _order(wcs: WCS) -> list[int]:
    """Return the axes as longitude, latitude, third; without a sky, with the spectral axis last."""
    if wcs.wcs.lng >= 0 and wcs.wcs.lat >= 0:
        first = [wcs.wcs.lng, wcs.wcs.lat]
        return [*first, *({0, 1, 2} - set(first))]
    spectral = wcs.wcs.spec
    return [k for k in range(3) if k != spectral] + ([spectral] if spectral >= 0 else [])


def _linear(wcs: WCS) -> np.ndarray:
    return np.asarray(np.diag(wcs.wcs.get_cdelt()) @ wcs.wcs.get_pc())


def _check_apart(wcs: WCS) -> None:
    """Refuse non-orthogonal axes, except on the sky."""
    linear = np.abs(_linear(wcs))
    if not np.all(np.isfinite(linear)) or not np.all(linear.max(axis=1) > 0):
        raise FileFormatError(f"a pixel of the WCS has no size{HINT}")
    linear = linear / linear.max(axis=1, keepdims=True)
    mixed = linear - np.diag(np.diag(linear))
    if wcs.has_celestial:
        mixed[:2, :2] = 0.0
    if mixed.max() > 1e-9:
        raise FileFormatError(f"the axes of the WCS are turned (PC or CD cards){HINT}")


def _converted(wcs: WCS, velocity: str | None) -> WCS:
    """Return the WCS with its spectral axis converted to velocity, if possible."""
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
    linear = _linear(wcs)
    own = [0, 1, 2]
    if abs(linear[0, 1] * linear[1, 0]) > abs(linear[0, 0] * linear[1, 1]):
        own = [1, 0, 2]  # rotated by about 90 degrees
    signs = np.sign([linear[k, own[k]] for k in range(3)])
    for k in range(3):
        if wcs.wcs.ctype[k].endswith("-TAB"):  # the table may descend
            ends = wcs.sub([k + 1]).wcs_pix2world([[0], [sides[k] - 1]], 0)[:, 0]
            signs[k] = np.sign(ends[1] - ends[0])
    if wcs.has_celestial:
        signs[0] *= -1  # x runs to the right, which is west
    matrix, origin = np.zeros((3, 3)), np.zeros(3)
    for k in range(3):
        matrix[own[k], k] = 1.0 if signs[k] > 0 else -1.0
        origin[own[k]] = 0.0 if signs[k] > 0 else sides[own[k]] - 1.0
    return matrix, origin, own
