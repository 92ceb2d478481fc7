"""The WCS in the header of a cube, of which some spellings are mended."""

from __future__ import annotations

import warnings
from typing import Any

from ...errors import FileFormatError, InputError
from .blocks import Part, card
from .units import fits_name, lenient_unit
from .values import image_shape, is_compressed

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
    from astropy.wcs import WCS

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        header = _mended(part, rest)
        try:
            wcs = WCS(header)
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
