"""Unit spellings in FITS headers: standard, in capitals, or with remarks."""

from __future__ import annotations

import functools
import re
import warnings
from collections.abc import Iterator
from typing import Any

# Remarks on the kind of brightness temperature: (Ta*), [Tmb], T_B …
_REMARKS = re.compile(r"[(\[]\s*[A-Za-z][^)\]]*[)\]]|\bT_?(?:A|MB|B|R)\b\*?", re.I)
# Maximum length of a string in a card.
_LONGEST = 68
_WORD = re.compile(r"[A-Za-z]+")
# Case-insensitive words with a unique meaning ("MJY" is ambiguous).
_MEANT = {
    **{name.lower(): name for name in ("Jy", "K", "beam", "Hz", "kHz", "GHz", "sr", "erg", "deg")},
    **{name.lower(): name for name in ("arcsec", "arcmin", "km", "cm", "m", "s", "pc", "kpc")},
    **{name.lower(): name for name in ("Angstrom", "nm", "um", "AU", "rad", "W", "adu", "DN")},
    **dict.fromkeys(("jansky", "janskys"), "Jy"),
    **dict.fromkeys(("kelvin", "kelvins"), "K"),
    **dict.fromkeys(("pixel", "pixels", "px", "pix"), "pix"),
    **dict.fromkeys(("degree", "degrees"), "deg"),
    **dict.fromkeys(("arcsecond", "arcseconds", "asec"), "arcsec"),
    **dict.fromkeys(("count", "counts", "cts"), "ct"),
    **dict.fromkeys(("electrons", "e-"), "electron"),
    **dict.fromkeys(("micron", "microns", "mum", "micrometer"), "um"),
    **dict.fromkeys(("angstroms", "ang"), "Angstrom"),
    **dict.fromkeys(("sec", "second", "seconds"), "s"),
    **dict.fromkeys(("meter", "metre", "meters", "metres"), "m"),
    **dict.fromkeys(("bm", "beams"), "beam"),
    **dict.fromkeys(("ster", "steradian"), "sr"),
    "ergs": "erg",
    "mhz": "MHz",
    "mpc": "Mpc",
}


@functools.lru_cache(maxsize=256)
def lenient_unit(text: str) -> Any:
    """Return the astropy unit for a text; None if it is not a unit or cannot be parsed.

    Examples
    --------
    >>> str(lenient_unit("JY/BEAM")), str(lenient_unit("K (Ta*)")), lenient_unit("UNKNOWN")
    ('Jy / beam', 'K', None)
    """
    from astropy import units as u

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for spelling in _spellings(text.strip()):
            for form in ("fits", None):
                try:
                    unit = u.Unit(spelling, format=form)
                except (ValueError, TypeError):
                    continue
                return None if unit == u.dimensionless_unscaled else unit
    return None


def fits_name(unit: Any) -> str:
    """Return the FITS name of a unit, or its usual name if FITS has none."""
    if unit is None:
        return ""
    try:
        return str(unit.to_string("fits"))
    except ValueError:
        return str(unit)[:_LONGEST]


def _spellings(text: str) -> Iterator[str]:
    """Yield a unit text as written, without remarks, and with the usual lower-case letters."""
    if not text:
        return
    # CASA's spelling of a spectral sum; the standard would put everything in the denominator.
    text = re.sub(r"/beam\.km/s\b", ".km/s/beam", text, flags=re.I)
    yield text
    bare = _REMARKS.sub("", text).strip()
    for spelling in dict.fromkeys((bare, *(_spelled(t) for t in (text, bare)))):
        if spelling:
            yield spelling


def _spelled(text: str) -> str:
    return _WORD.sub(lambda word: _MEANT.get(word[0].lower(), word[0]), text)
