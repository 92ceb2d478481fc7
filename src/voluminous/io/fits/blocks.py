"""The parts of a FITS file (HDUs): their headers, and where their data are.

FITS Standard 4.0, sections 3 and 4: headers of 80-byte cards and data, in blocks of 2880 bytes.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from ...errors import FileFormatError
from ..payload import is_packed, unpacked

BLOCK = 2880
_MOST_PARTS = 100_000
_MOST_AXES = 999


@dataclass(frozen=True)
class Part:
    """A header and its data.

    Attributes
    ----------
    number : int
        0 is the primary one.
    header : astropy.io.fits.Header
        Its cards.
    start, size : int
        Where the data begin in the (unpacked) file, and their bytes.
    path : Path
        The file.
    """

    number: int
    header: Any
    start: int
    size: int
    path: Path

    @property
    def name(self) -> str:
        """What it is called in error messages."""
        title = str(self.header.get("EXTNAME", "")).strip()
        return f"HDU {self.number}" + (f" ({title})" if title else "")

    def whole(self, key: str, default: int | None = None) -> int:
        """Return a card that must be a whole number.

        Raises
        ------
        FileFormatError
            If it is not there and there is no default, or it is something else.
        """
        value = card(self.header, key, default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise FileFormatError(f"{self.name}: {key} is {value!r}, expected a whole number")
        return value


def card(header: Any, key: str, default: Any = None) -> Any:
    """Return the value of a card; the default if there is none, or it cannot be read."""
    from astropy.io.fits import VerifyError
    from astropy.io.fits.card import Undefined

    try:
        value = header.get(key, default)
    except (VerifyError, ValueError):
        return default
    return default if isinstance(value, Undefined) else value


def parts(path: Path) -> list[Part]:
    """Return all parts of a file; no data are read.

    Raises
    ------
    FileFormatError
        If a header is damaged, or promises more data than there are.
    """
    with unpacked(path) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # astropy's, of cards that nobody needs
        return list(_walk(file, path))


def _walk(file: IO[bytes], path: Path) -> Iterator[Part]:
    # How long a packed file is shows only when all of it is unpacked.
    length = None if is_packed(start_of(path)) else path.stat().st_size
    at = 0
    for number in range(_MOST_PARTS):
        header, at = _header(file, number, at)
        if header is None:
            return
        part = Part(number, header, at, _data_size(Part(number, header, at, 0, path)), path)
        end = at + part.size
        file.seek(end if length is None else min(end, length))
        # Behind the end of a packed file nothing is found: it stays where that is.
        if file.tell() < end:
            raise FileFormatError(
                f"{part.name} is cut short: its header promises {part.size} bytes of data "
                f"(BITPIX {header['BITPIX']}, {_times(header)}), there are {file.tell() - at}"
            )
        yield part
        at = end + -end % BLOCK
        file.seek(at)


def start_of(path: Path) -> bytes:
    """Return the first bytes of a file, as they are on the disk."""
    with open(path, "rb") as file:
        return file.read(8)


def _header(file: IO[bytes], number: int, at: int) -> tuple[Any, int]:
    """Return the header that begins here and where it ends; None if no part follows."""
    from astropy.io import fits

    start = file.read(8)
    file.seek(at)
    if number and start != b"XTENSION":
        return None, at  # the end, or what some programs leave behind the last part
    try:
        header = fits.Header.fromfile(file)
    except (EOFError, OSError, ValueError, fits.VerifyError) as error:
        raise FileFormatError(
            f"HDU {number} is cut short or damaged: there is no END card in its header ({error})"
        ) from error
    return header, file.tell()


def _data_size(part: Part) -> int:
    sides = shape(part)
    if not sides:
        return 0
    width = part.whole("BITPIX")
    if abs(width) not in (8, 16, 32, 64):
        raise FileFormatError(f"{part.name}: BITPIX is {width}, expected ±8, ±16, ±32 or ±64")
    groups = card(part.header, "GROUPS") is True and sides[0] == 0
    values = math.prod(sides[1:] if groups else sides)
    extra, count = part.whole("PCOUNT", 0), part.whole("GCOUNT", 1)
    if min(extra, count) < 0:
        raise FileFormatError(f"{part.name}: PCOUNT {extra} and GCOUNT {count} must not be < 0")
    return abs(width) // 8 * count * (extra + values)


def shape(part: Part, prefix: str = "") -> tuple[int, ...]:
    """Return the sides of the data in the order of FITS: the first axis is fastest."""
    axes = part.whole(f"{prefix}NAXIS")
    if not 0 <= axes <= _MOST_AXES:
        raise FileFormatError(f"{part.name}: NAXIS is {axes}, expected 0 to {_MOST_AXES}")
    sides = tuple(part.whole(f"{prefix}NAXIS{k + 1}") for k in range(axes))
    if min(sides, default=0) < 0:
        raise FileFormatError(f"{part.name}: an axis has {min(sides)} pixels")
    return sides


def _times(header: Any) -> str:
    return " x ".join(str(header[f"NAXIS{k + 1}"]) for k in range(header["NAXIS"])) + " values"
