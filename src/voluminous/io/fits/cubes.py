"""The cubes in a FITS file: images with three axes after dropping or selecting the others."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError, unknown_name
from ...image.fits_header import ON_SKY, SPECTRUM, card, lenient_unit, text
from ...memory import check_memory
from ..guard import by_library
from ..names import field_name

if TYPE_CHECKING:
    from astropy import units as u
    from astropy.io.fits import HDUList, Header

# astropy's name of a compressed image without a name.
_NAMELESS = {"", "COMPRESSED_IMAGE", "PRIMARY"}
_PLACE = ("X", "Y", "Z")
_STOKES = "STOKES"


@contextmanager
def opened(path: Path) -> Iterator[HDUList]:
    """Open a file; stored numbers are not scaled, and a file that is cut short is an error."""
    from astropy.io import fits

    with by_library("astropy"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of irrelevant cards
        warnings.filterwarnings("error", message=".*truncated.*")
        # astropy does not close a truncated file that it has opened itself.
        with (
            open(path, "rb") as file,
            fits.open(file, do_not_scale_image_data=True, memmap=False) as hdus,
        ):
            for hdu in hdus:  # reads all headers; astropy would never come to an end of these
                if hdu.is_image and min(hdu.shape, default=0) < 0:
                    raise FileFormatError(f"an axis has {min(hdu.shape)} pixels")
            yield hdus


@dataclass(frozen=True)
class FITSImage:
    """An image in a file, without its values."""

    path: Path
    number: int  # of its HDU; 0 is the primary one
    header: Header
    shape: tuple[int, ...]  # in FITS order: the first axis varies fastest

    @property
    def title(self) -> str:
        """Name of the HDU."""
        title = str(card(self.header, "EXTNAME", "")).strip()
        return "" if title.upper() in _NAMELESS else title

    def __str__(self) -> str:
        """Return its name in error messages."""
        return f"HDU {self.number}" + (f" ({self.title})" if self.title else "")

    @property
    def real_axes(self) -> list[int]:
        """Axes of more than one pixel, or along x, y and z in space, where a slab may be thin."""
        return [
            k
            for k, n in enumerate(self.shape)
            if n > 1 or text(self.header, f"CTYPE{k + 1}") in _PLACE
        ]


def images(path: Path) -> list[FITSImage]:
    """Return all non-empty images of a file."""
    with opened(path) as hdus:
        candidates = [
            FITSImage(path, number, hdu.header, hdu.shape[::-1])
            for number, hdu in enumerate(hdus)
            if hdu.is_image and card(hdu.header, "GROUPS") is not True
        ]
    return [image for image in candidates if min(image.shape, default=0) > 0]


@dataclass(frozen=True)
class Cube:
    """An image reduced to three axes."""

    image: FITSImage
    name: str  # field name
    place: str  # its identifier in `fields=`: name or number of the HDU
    axes: tuple[int, ...]  # the three axes of the image; 0 is NAXIS1
    index: tuple[Any, ...]  # index that selects the cube from the array, in NumPy's order

    @property
    def sides(self) -> tuple[int, ...]:
        """Number of pixels along each axis."""
        return tuple(self.image.shape[axis] for axis in self.axes)

    @property
    def unit(self) -> u.UnitBase | None:
        """Unit of the values."""
        return lenient_unit(str(card(self.image.header, "BUNIT", "")))

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the values: whole numbers if they are not scaled, and none can be missing."""
        return value_type(self.image.header)

    def values(self, arrange: Any) -> np.ndarray:
        """Return the values, after the stored numbers pass through `arrange`."""
        size = int(np.prod(self.image.shape, dtype=object)) * self.dtype.itemsize
        check_memory(size, f"reading {self.image}", "read a part of it; is the file damaged?")
        with opened(self.image.path) as hdus:
            # Not mapped; astropy may keep an axis of one pixel that a number stands for.
            slices = tuple(slice(i, i + 1) if isinstance(i, int) else i for i in self.index)
            values = hdus[self.image.number].section[slices]
            index = tuple(0 if isinstance(i, int) else slice(None) for i in self.index)
            return scaled(arrange(values[index]), self.image.header)


def _scaling(header: Header) -> tuple[float, float, int | None]:
    blank = card(header, "BLANK") if header["BITPIX"] > 0 else None
    return float(card(header, "BSCALE", 1)), float(card(header, "BZERO", 0)), blank


def value_type(header: Header) -> np.dtype[Any]:
    """Return the type of the values: FITS Standard 4.0, section 4.4.2 (BSCALE, BZERO, BLANK)."""
    bits = abs(header["BITPIX"])
    scale, zero, blank = _scaling(header)
    # FITS has one integer type of each width: BZERO makes that of the other signedness.
    other = -128 if bits == 8 else 2.0 ** (bits - 1)
    if header["BITPIX"] < 0:
        return np.dtype(np.float64 if bits == 64 else np.float32)
    if scale != 1 or blank is not None or zero not in (0, other):
        return np.dtype(np.float64 if bits > 16 else np.float32)
    return np.dtype(f"{'iu'[(bits == 8) != (zero != 0)]}{bits // 8}")


def scaled(stored: np.ndarray, header: Header) -> np.ndarray:
    """Return values of stored numbers, NaN for missing ones."""
    dtype, (scale, zero, blank) = value_type(header), _scaling(header)
    if (scale, zero, blank) == (1, 0, None):
        return stored
    if dtype.kind != "f":  # adding half of the range flips the highest bit
        unsigned = stored.astype(f"=u{dtype.itemsize}", casting="unsafe")
        return np.asarray((unsigned ^ unsigned.dtype.type(1 << 8 * dtype.itemsize - 1)).view(dtype))
    values: np.ndarray = stored.astype(dtype)
    values *= scale
    values += zero
    if blank is not None:
        values[stored == blank] = np.nan
    return values


def cubes(candidates: Sequence[FITSImage], hdu: Any = None, plane: Any = None) -> list[Cube]:
    """Return the cubes of a file, or of one HDU if it is given."""
    listed = list(candidates) if hdu is None else [_named(candidates, hdu)]
    some = [image for image in listed if len(image.real_axes) >= 3]
    if not some:
        flat = ", ".join(f"{image}: {' x '.join(map(str, image.shape))}" for image in listed[:8])
        raise FileFormatError(
            "expected an image with three axes"
            + (
                f", found {flat}; vm.Image.load reads images of two axes"
                if flat
                else "; there is no image with values in it"
            )
        )
    titles = [image.title for image in some]
    places = [t if t and titles.count(t) == 1 else "" for t in titles]
    return [
        _cube(image, name, place or str(image.number), plane)
        for image, name, place in zip(some, _names(some), places, strict=True)
    ]


def _named(candidates: Sequence[FITSImage], hdu: Any) -> FITSImage:
    names = {str(image.number): image for image in candidates}
    names |= {image.title.upper(): image for image in reversed(candidates) if image.title}
    key = str(hdu).strip().upper()
    if key not in names:
        raise unknown_name("HDU", str(hdu), names)
    return names[key]


def _names(some: list[FITSImage]) -> list[str]:
    """Return field names: EXTNAME, else BTYPE, else "intensity"; numbered if equal."""
    names: list[str] = []
    for image in some:
        kind, title = str(card(image.header, "BTYPE", "")).strip(), image.title
        if not (title and kind.upper() == title.upper()):  # astropy capitalizes our EXTNAME
            kind = (
                title if title and not title.isupper() else (title or kind or "intensity").lower()
            )
        name = field_name(kind)
        names.append(f"{name}_{image.number}" if name in names else name)
    return names


def _cube(image: FITSImage, name: str, place: str, plane: Any) -> Cube:
    """Return a cube: of more than three axes sky and spectrum take precedence."""
    real, shape = image.real_axes, image.shape
    kinds = {k: text(image.header, f"CTYPE{k + 1}") for k in real}
    known = [k for k in real if kinds[k].startswith(SPECTRUM) or ON_SKY.match(kinds[k])]
    rest = sorted((k for k in real if k not in known), key=lambda k: kinds[k] == _STOKES)
    axes = sorted([*known, *rest][:3])
    others = [k for k in real if k not in axes]
    chosen = np.atleast_1d([0] * len(others) if plane is None else plane).tolist()
    if plane is None and any(kinds[k] != _STOKES for k in others):
        listed = ", ".join(f"{kinds[k] or 'an axis'} of {shape[k]}" for k in others)
        raise InputError(f"{image} has {len(real)} axes; choose with plane=0 … along {listed}")
    if len(chosen) != len(others):
        raise InputError(
            f"{image} has {len(others)} axes beyond three, plane gives {len(chosen)} numbers"
        )
    for k, number in zip(others, chosen, strict=True):
        if not isinstance(number, int) or not 0 <= number < shape[k]:
            raise InputError(f"plane must be a whole number below {shape[k]}, got {plane!r}")
    single = dict(zip(others, chosen, strict=True))
    index = [slice(None) if k in axes else single.get(k, 0) for k in range(len(shape))]
    return Cube(image, name, place, tuple(axes), tuple(index[::-1]))
