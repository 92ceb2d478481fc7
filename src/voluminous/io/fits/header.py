"""The WCS in the header of a cube, of which some spellings are mended."""

from __future__ import annotations

import math
import re
import warnings
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError
from .blocks import Part, card
from .table_axis import put_centers, skirt_centers
from .units import fits_name, lenient_unit
from .values import image_shape, is_compressed, number

# What programs write, and what the standard calls it.
_TYPES = {
    "VELOCITY": "VELO",
    "VELOCIT": "VELO",
    "FREQUENC": "FREQ",
    "FREQUENCY": "FREQ",
    "LAMBDA": "WAVE",
    "WAVELENG": "WAVE",
    "WAVELENGTH": "WAVE",
}
# CD1_2, and PC001002 as it was before the standard.
_CARD = re.compile(r"(CD|PC)(\d\d?_\d\d?|\d{6})")
# The most that the standard has room for in names of cards.
_MOST_AXES = 99
# What to do about a header that is wrong.
HINT = "; open it with wcs=False for cells of unit length, or with bounds=…"


def has_world(part: Part) -> bool:
    """Return True if a header says anything of where pixels are."""
    keys = ("CDELT", "CTYPE", "CRVAL", "CD", "PC")
    return any(f"{key}{end}" in part.header for key in keys for end in ("1", "2", "1_1", "001001"))


def wcs_of(part: Part, rest: str | None) -> Any:
    """Return the WCS of a header, of which some spellings are mended."""
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
        except Exception as error:  # wcslib and astropy raise many kinds
            told = str(error).strip().splitlines()[-1]
            raise FileFormatError(f"{part.name}: its WCS is wrong ({told}){HINT}") from error
    # Not of three axes, and not to be turned.
    wcs.sip = wcs.cpdis1 = wcs.cpdis2 = wcs.det2im1 = wcs.det2im2 = None
    return wcs


def _mended(part: Part, rest: str | None) -> Any:
    header = part.header.copy()
    if is_compressed(part):  # its own axes are those of a table
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


def _put_one_matrix(part: Part, header: Any) -> None:
    """Describe axes with CDi_j cards and axes without them by CDi_j cards alone.

    wcslib takes one way for all axes, and steps of 1 for those that are described in another.
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
            if key.startswith("CD"):  # all zero: they describe nothing
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


def _put_rest(header: Any, rest: Any) -> None:
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
