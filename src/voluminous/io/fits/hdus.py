"""The parts of a FITS file (HDUs): headers, data offsets, and stored numbers.

FITS Standard 4.0, sections 3 and 4: headers of 80-byte cards and data, in blocks of 2880 bytes.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from ..payload import is_packed, mapped, read_exactly, unpacked

if TYPE_CHECKING:
    from astropy.io.fits import Header

BLOCK = 2880
_MOST_PARTS = 100_000
_MOST_AXES = 999


@dataclass(frozen=True)
class HDU:
    """A header and its data."""

    number: int  # 0 is the primary HDU
    header: Header  # astropy.io.fits.Header
    start: int  # offset of the data in the (decompressed) file
    size: int  # size of the data in bytes
    path: Path

    @property
    def name(self) -> str:
        """Its name in error messages."""
        title = str(self.header.get("EXTNAME", "")).strip()
        return f"HDU {self.number}" + (f" ({title})" if title else "")

    def whole(self, key: str, default: int | None = None) -> int:
        """Return the value of a card that must be an integer."""
        value = card(self.header, key, default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise FileFormatError(f"{self.name}: {key} is {value!r}, expected a whole number")
        return value


def card(header: Header, key: str, default: Any = None) -> Any:
    """Return the value of a card; the default if the card is missing or unreadable."""
    from astropy.io.fits import VerifyError
    from astropy.io.fits.card import Undefined

    try:
        value = header.get(key, default)
    except (VerifyError, ValueError):
        return default
    return default if isinstance(value, Undefined) else value


def parts(path: Path) -> list[HDU]:
    """Return all HDUs of a file, without reading data."""
    with unpacked(path) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # astropy warns of irrelevant cards
        return list(_walk(file, path))


def _walk(file: IO[bytes], path: Path) -> Iterator[HDU]:
    # The length of a compressed file follows only from decompressing all of it.
    length = None if is_packed(start_of(path)) else path.stat().st_size
    at = 0
    for number in range(_MOST_PARTS):
        header, at = _header(file, number, at)
        if header is None:
            return
        part = HDU(number, header, at, _data_size(HDU(number, header, at, 0, path)), path)
        end = at + part.size
        file.seek(end if length is None else min(end, length))
        # A seek beyond the end of a compressed file stops at the end.
        if file.tell() < end:
            raise FileFormatError(
                f"{part.name} is cut short: its header promises {part.size} bytes of data "
                f"(BITPIX {header['BITPIX']}, {_times(header)}), there are {file.tell() - at}"
            )
        yield part
        at = end + -end % BLOCK
        file.seek(at)


def start_of(path: Path) -> bytes:
    """Return the first bytes of a file, as stored on disk."""
    with open(path, "rb") as file:
        return file.read(8)


def _header(file: IO[bytes], number: int, at: int) -> tuple[Any, int]:
    """Return the header at an offset and the offset of its end; None if no HDU follows."""
    from astropy.io import fits

    start = file.read(8)
    file.seek(at)
    if number and start != b"XTENSION":
        return None, at  # the end, or padding that some programs append
    try:
        header = fits.Header.fromfile(file)
    except (EOFError, OSError, ValueError, fits.VerifyError) as error:
        raise FileFormatError(
            f"HDU {number} is cut short or damaged: there is no END card in its header ({error})"
        ) from error
    return header, file.tell()


def _data_size(part: HDU) -> int:
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


def shape(part: HDU, prefix: str = "") -> tuple[int, ...]:
    """Return the data shape in FITS order: the first axis varies fastest."""
    axes = part.whole(f"{prefix}NAXIS")
    if not 0 <= axes <= _MOST_AXES:
        raise FileFormatError(f"{part.name}: NAXIS is {axes}, expected 0 to {_MOST_AXES}")
    sides = tuple(part.whole(f"{prefix}NAXIS{k + 1}") for k in range(axes))
    if min(sides, default=0) < 0:
        raise FileFormatError(f"{part.name}: an axis has {min(sides)} pixels")
    return sides


def _times(header: Header) -> str:
    return " x ".join(str(header[f"NAXIS{k + 1}"]) for k in range(header["NAXIS"])) + " values"


_TYPES = {8: "u1", 16: "i2", 32: "i4", 64: "i8", -32: "f4", -64: "f8"}
# Upper limit of values per compressed byte; images smaller than `_SMALL` are not checked.
_MOST_PACKED, _SMALL = 4096, 1 << 22


@dataclass(frozen=True)
class Scaling:
    """Conversion of stored numbers: ``bzero + bscale * stored``, and the number that means NaN.

    FITS Standard 4.0, section 4.4.2 (BSCALE, BZERO, BLANK).
    """

    stored: np.dtype
    bscale: float
    bzero: float
    blank: int | None

    @property
    def shifted(self) -> bool:
        """True for integers of the opposite signedness: FITS has one integer type of each width."""
        if self.stored.kind == "f" or self.bscale != 1:
            return False
        return self.bzero == (-128 if self.stored.kind == "u" else 2 ** (_bits(self.stored) - 1))

    @property
    def whole(self) -> bool:
        """True if the values are integers of the stored width."""
        return self.stored.kind != "f" and ((self.bscale, self.bzero) == (1, 0) or self.shifted)

    @property
    def floating(self) -> np.dtype:
        """The floating-point type of the values."""
        wide = self.stored.itemsize > (4 if self.stored.kind == "f" else 2)
        return np.dtype(np.float64 if wide else np.float32)

    @property
    def integral(self) -> np.dtype:
        """The integer type of the values, if they are `whole`."""
        kind = {"u": "i", "i": "u"}[self.stored.kind] if self.shifted else self.stored.kind
        return np.dtype(f"{kind}{self.stored.itemsize}")

    @property
    def dtype(self) -> np.dtype:
        """The type of the values; integers with possible missing values become floats."""
        return self.integral if self.whole and self.blank is None else self.floating

    def apply(self, stored: np.ndarray) -> np.ndarray:
        """Return the values in C order, NaN for missing ones."""
        missing = None if self.blank is None else stored == self.blank
        if missing is not None and not missing.any():
            missing = None
        if self.whole and missing is None:
            return self._integers(stored)
        if (self.bscale, self.bzero) == (1, 0) and missing is None:
            return stored
        values = stored.astype(self.floating, order="C")
        values *= self.bscale
        values += self.bzero
        if missing is not None:
            values[missing] = np.nan
        return values

    def _integers(self, stored: np.ndarray) -> np.ndarray:
        if not self.shifted:
            return stored
        # Adding half of the range flips the highest bit.
        unsigned = stored.astype(f"=u{self.stored.itemsize}", order="C", casting="unsafe")
        unsigned ^= unsigned.dtype.type(1 << (_bits(self.stored) - 1))
        return unsigned.view(self.integral)


def _bits(dtype: np.dtype) -> int:
    return 8 * dtype.itemsize


def is_compressed(part: HDU) -> bool:
    """Return True for a tile-compressed image, which FITS stores in a table."""
    return card(part.header, "ZIMAGE") is True


def is_image(part: HDU) -> bool:
    """Return True if the HDU has an image, not a table."""
    if part.number and not is_compressed(part):
        return str(card(part.header, "XTENSION", "")).strip() == "IMAGE"
    return card(part.header, "GROUPS") is not True


def image_shape(part: HDU) -> tuple[int, ...]:
    """Return the shape of an image in FITS order, compressed or not."""
    return shape(part, "Z" if is_compressed(part) else "")


def scaling(part: HDU) -> Scaling:
    """Return the conversion from the stored numbers of an image to values."""
    width = part.whole("ZBITPIX" if is_compressed(part) else "BITPIX")
    if width not in _TYPES:
        raise FileFormatError(f"{part.name}: BITPIX is {width}, expected one of {list(_TYPES)}")
    stored = np.dtype(_TYPES[width])
    blank = None
    for key in ("BLANK", "ZBLANK"):
        if stored.kind != "f" and blank is None and key in part.header:
            blank = part.whole(key)
    return Scaling(stored, number(part, "BSCALE", 1), number(part, "BZERO", 0), blank)


def number(part: HDU, key: str, default: float) -> float:
    """Return the value of a card that must be a finite number."""
    value = card(part.header, key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise FileFormatError(f"{part.name}: {key} is {value!r}, expected a number")
    return value


def stored(path: Path, part: HDU) -> np.ndarray:
    """Return the stored numbers of an image, indexed in NumPy's order (last FITS axis first).

    An uncompressed file is memory-mapped. The numbers of a compressed image are already scaled.
    """
    sides = image_shape(part)[::-1]
    if is_compressed(part):
        return _decompressed(path, part)
    dtype = scaling(part).stored.newbyteorder(">")
    if not is_packed(start_of(path)):
        return mapped(path, part.start, sides, dtype)
    with unpacked(path) as file:
        file.seek(part.start)
        return read_exactly(file, sides, dtype, f"the data of {part.name}")


def values(path: Path, part: HDU, index: tuple[Any, ...], arrange: Any) -> np.ndarray:
    """Return the values of a part of an image, after the stored numbers pass through `arrange`."""
    picked = arrange(stored(path, part)[index])
    return np.asarray(picked if is_compressed(part) else scaling(part).apply(picked))


def _decompressed(path: Path, part: HDU) -> np.ndarray:
    from astropy.io import fits

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with fits.open(path, memmap=False, uint=True) as hdus:
            return np.asarray(hdus[part.number].data)


def check_tiles(part: HDU) -> None:
    """Refuse impossible sizes of a compressed image.

    The sizes of uncompressed images are checked while the file is scanned.
    """
    sides = image_shape(part)
    tiles = [part.whole(f"ZTILE{k + 1}", n if k == 0 else 1) for k, n in enumerate(sides)]
    if min(tiles, default=1) < 1:
        raise FileFormatError(f"{part.name}: a tile has {min(tiles)} pixels along an axis")
    needed = math.prod(-(-n // tile) for n, tile in zip(sides, tiles, strict=True))
    if needed != part.whole("NAXIS2"):
        raise FileFormatError(
            f"{part.name}: the image has {needed} tiles, the table {part.whole('NAXIS2')} rows"
        )
    if math.prod(sides) > max(_SMALL, _MOST_PACKED * part.size):
        raise FileFormatError(
            f"{part.name}: {part.size} bytes cannot hold the {math.prod(sides)} values of the image"
        )
