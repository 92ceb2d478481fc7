"""What a FITS header says of units, coordinates, spectra and beams, for pictures and for volumes.

Greisen & Calabretta (2002), Calabretta & Greisen (2002), Greisen et al. (2006): FITS papers I-III.
Headers are mended where programs write what the standard does not have. Axes with tabulated
coordinates (``-TAB`` of paper III, section 6, and SKIRT's) become a ``-TAB`` axis with one
coordinate per pixel and no index.
"""

from __future__ import annotations

import functools
import re
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FileFormatError, InputError
from ..packages import require
from .sky import table_hdus

if TYPE_CHECKING:
    from astropy.io.fits import HDUList, Header
    from astropy.wcs import WCS

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
    **dict.fromkeys(("radian", "radians"), "rad"),
    **{name.lower(): name for name in ("eV", "keV", "MeV", "GeV")},
    "hertz": "Hz",
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
    if not text:
        return
    # CASA's spelling of a spectral sum; the standard would put everything in the denominator.
    text = re.sub(r"/beam\.km/s\b", ".km/s/beam", text, flags=re.I)
    text = re.sub(r"(erg.*[\s/*.])A\b", r"\1Angstrom", text)  # a flux is not per ampere
    yield text
    bare = _REMARKS.sub("", text).strip()
    for spelling in dict.fromkeys((bare, *(_spelled(t) for t in (text, bare)))):
        if spelling:
            yield spelling


def _spelled(text: str) -> str:
    return _WORD.sub(lambda word: _MEANT.get(word[0].lower(), word[0]), text)


# Kinds of axes on the sky, and along a spectrum, as their types begin.
ON_SKY = re.compile("(RA|DEC|[A-Z]{1,2}L(ON|AT))(-|$)")
SPECTRUM = (
    *("VEL", "VLSR", "VRAD", "VOPT", "FELO", "FREQ", "AFRQ", "WAV", "AWAV", "LAMBDA"),
    *("ZOPT", "BETA", "ENER"),
)
# Non-standard spellings and their standard form, and the types of units.
_TYPES = {
    **dict.fromkeys(("VELOCITY", "VELOCIT", "VEL", "VLSR"), "VELO"),
    **dict.fromkeys(("FREQUENC", "FREQUENCY"), "FREQ"),
    **dict.fromkeys(("LAMBDA", "WAVELENG", "WAVELENGTH"), "WAVE"),
    "ENERGY": "ENER",
}
_KINDS = {"length": "WAVE", "frequency": "FREQ", "energy": "ENER", "speed": "VRAD"}
# Lengths that beside a sky are wavelengths.
_OF_WAVES = ("Angstrom", "nm", "um")
# Texts that say that there is no unit.
_NO_UNIT = ("", "1", "-", "NONE", "UNITLESS", "DIMENSIONLESS")
_SKIRT = "Z-AXIS COORDINATE VALUES"
_TABLE, _COLUMN = "VOLTABLE", "CENTERS"
# CD1_2, and the pre-standard form PC001002.
_MATRIX = re.compile(r"(CD|PC)0*(\d+?)(?:_|0+)(\d+)")
_OF_BEAM = ("BMAJ", "BMIN", "BPA")
# A beam in the history, as AIPS writes it.
_BEAM = re.compile(r"BMAJ=\s*(\S+)\s+BMIN=\s*(\S+)\s+BPA=\s*(\S+)")


def card(header: Header, key: str, default: Any = None) -> Any:
    """Return the value of a card; the default if the card is missing or unreadable."""
    from astropy.io.fits import VerifyError
    from astropy.io.fits.card import Undefined

    try:
        value = header.get(key, default)
    except (VerifyError, ValueError):
        return default
    return default if isinstance(value, Undefined) else value


def text(header: Header, key: str) -> str:
    """Return the text of a card in capitals."""
    return str(card(header, key, "")).strip().upper()


def is_casa_image(path: Path) -> bool:
    """Return True for an image of CASA: a directory of tables."""
    try:
        head = (path / "table.info").read_bytes() if (path / "table.dat").is_file() else b""
    except OSError:
        return False
    return b"Type = Image" in head[:200]


@contextmanager
def as_fits(path: Path) -> Iterator[Path]:
    """Give a temporary FITS file of a CASA image."""
    images = require(
        "casacore.images", "casa", "reading a CASA image (its exportfits makes it a FITS file)"
    )
    with tempfile.TemporaryDirectory(prefix="voluminous-") as folder:
        images.image(str(path.resolve())).tofits(f"{folder}/image.fits", velocity=False)
        yield Path(folder, "image.fits")


def world_of(
    header: Header,
    shape: tuple[int, ...],
    opening: Callable[[], AbstractContextManager[HDUList]],
    rest: Any = None,
) -> tuple[WCS, Header]:
    """Return the WCS of all axes of an image, and its header as it is meant.

    `shape` is in FITS order: the first axis varies fastest. `opening` gives the HDUs of the file,
    for tables of coordinates. Errors are those of wcslib and astropy, or a ValueError that says
    what would be taken for something else.
    """
    from astropy.wcs import WCS

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mended = _mended(header, shape, rest)
        wcs = WCS(mended, _put_tables(mended, shape, opening))
        wcs.wcs.set()
    return wcs, mended


def beam_of(header: Header, hdus: HDUList, planes: int) -> dict[str, Any] | None:
    """Return the beam of an image as its provenance has it: BMAJ, BMIN, BPA, or AIPS's history.

    CASA's table BEAMS (CASAMBM) has one for each plane: then widths and angles are lists, with NaN
    for planes without one.
    """
    beam: Any = [card(header, name) for name in _OF_BEAM]
    history = " ".join(map(str, header.get("HISTORY", ())))
    if beam[0] is None and (found := _BEAM.findall(history)):
        beam = [float(number) for number in found[-1]]  # of the last CLEAN
    if card(header, "CASAMBM") is True:
        table = next((hdu for hdu in hdus if hdu.name == "BEAMS" and not hdu.is_image), None)
        rows: Any = [] if table is None else table.data
        if len(rows) and "POL" in rows.names:
            rows = rows[rows["POL"] == rows["POL"].min()]
        if len(rows) != planes:
            raise FileFormatError(
                f"CASAMBM says that each of {planes} planes has a beam, and there are {len(rows)} "
                "in a table BEAMS; write the image with one beam (imsmooth, kind='commonbeam')"
            )
        rows = rows[np.argsort(rows["CHAN"])] if "CHAN" in rows.names else rows
        units = [lenient_unit(rows.columns[name].unit or "arcsec") for name in _OF_BEAM]
        beam = np.array([rows[name] for name in _OF_BEAM], np.float64)
        beam *= np.array([[unit.to("deg")] for unit in units])
        beam[:, ~(beam[1] > 0)] = np.nan
        beam = beam[:, 0].tolist() if (beam == beam[:, :1]).all() else beam.tolist()
    elif not all(isinstance(width, (int, float)) and width > 0 for width in beam[:2]):
        return None
    major, minor, pa = beam
    return {"major": major, "minor": minor, "pa": pa or 0.0, "unit": "deg"}


def _mended(header: Header, shape: tuple[int, ...], rest: Any) -> Header:
    from astropy import units as u

    header = header.copy()
    count = max(int(card(header, "WCSAXES", 0)), len(shape))
    kinds = {k: text(header, f"CTYPE{k}") for k in range(1, count + 1)}
    on_sky = any(map(ON_SKY.match, kinds.values()))
    for k, kind in kinds.items():
        unit_text = text(header, f"CUNIT{k}")
        unit = lenient_unit(str(card(header, f"CUNIT{k}", "")))
        if on_sky and unit is not None and kind in ("", "LINEAR"):
            is_wave = unit.physical_type != "length" or unit.to_string() in _OF_WAVES
            named = (_KINDS[name] for name in _KINDS if is_wave and unit.physical_type == name)
            kind = next(named, kind)
        kind = _TYPES.get(kind, kind)
        is_known = kind.startswith(SPECTRUM) or ON_SKY.match(kind)
        if is_known:
            header[f"CTYPE{k}"] = kind
        if is_known and unit is None and unit_text not in _NO_UNIT:
            raise ValueError(f"{unit_text!r} of axis {k}, {kind}, is no known unit")
        if kind.startswith(SPECTRUM) and card(header, "DC-FLAG", 0) == 1:
            raise ValueError(f"axis {k}, {kind}, has logarithms of wavelengths (DC-FLAG)")
        if unit_text:
            header[f"CUNIT{k}"] = fits_name(unit)
    _put_one_matrix(header, count, len(shape))
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
        entries = [step * values.get(("PC", i, j), float(i == j)) for j in axes]
        rows[i] = [values.get(("CD", i, j), 0.0) for j in axes] if i in by_matrix else entries
        if i not in by_matrix and (not any(entries) or card(header, f"CROTA{i}", 0.0)):
            raise ValueError(f"CDELT{i} is missing, or CROTA{i} beside CD cards of others")
    for key, match in cards.items():
        if by_matrix or (match[1] == "CD" and "CDELT1" in header):  # all zero: no information
            del header[key]
        elif key != (name := f"{match[1]}{int(match[2])}_{int(match[3])}"):
            header.rename_keyword(key, name)
    for i, row in rows.items():
        header.remove(f"CROTA{i}", ignore_missing=True)
        header[f"CDELT{i}"] = 1.0
        for j, value in zip(axes, row, strict=True):
            if value:
                header[f"CD{i}_{j}"] = value


def _put_tables(
    header: Header, shape: tuple[int, ...], opening: Callable[[], AbstractContextManager[HDUList]]
) -> HDUList | None:
    """Give axes with tabulated coordinates one per pixel; return the HDUs that hold them."""
    from astropy.io import fits
    from astropy.wcs import WCS

    tabled = [k for k in range(len(shape)) if text(header, f"CTYPE{k + 1}").endswith("-TAB")]
    if not tabled and len(shape) != 3:
        return None
    with opening() as hdus:
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
                k: wcs.sub([k + 1]).wcs_pix2world(np.arange(shape[k])[:, None], 0)[:, 0]
                for k in tabled
            }
    tables = [_put_centers(header, k, values) for k, values in centers.items()]
    return fits.HDUList([fits.PrimaryHDU(), *tables]) if tables else None


def _put_centers(header: Header, axis: int, centers: np.ndarray) -> Any:
    """Assign pixel coordinates to an axis (from 0) of a header; return their table."""
    k = axis + 1
    count = header[f"NAXIS{k}"]
    if centers.shape != (count,):
        raise ValueError(f"the table of axis {k} has not {count} coordinates")
    for key in [key for key in header if key.startswith((f"CD{k}_", f"PC{k}_", f"PS{k}_"))]:
        del header[key]
    header.remove(f"CROTA{k}", ignore_missing=True)
    for key in ("CRPIX", "CRVAL", "CDELT"):
        header[f"{key}{k}"] = 1.0
    header[f"PS{k}_0"], header[f"PS{k}_1"] = f"{_TABLE}{k}", _COLUMN
    header[f"PV{k}_1"] = header[f"PV{k}_2"] = header[f"PV{k}_3"] = 1.0
    return table_hdus({(f"{_TABLE}{k}", _COLUMN): centers})[0]
