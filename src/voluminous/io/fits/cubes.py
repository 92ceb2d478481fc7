"""The cubes in a FITS file: images with three axes after dropping or selecting the others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError, unknown_name
from ...units import unit_name
from ..contract import FieldInfo
from ..names import field_name
from .hdus import HDU, Scaling, card, check_tiles, image_shape, is_compressed, is_image, scaling
from .units import lenient_unit

# astropy's name of a compressed image without a name.
_NAMELESS = {"", "COMPRESSED_IMAGE", "PRIMARY"}
_SKY = ("RA", "DEC", "GLON", "GLAT", "ELON", "ELAT", "SLON", "SLAT", "HLON", "HLAT")
_SPECTRUM = ("VEL", "VRAD", "VOPT", "FELO", "FREQ", "WAV", "AWAV", "ZOPT", "BETA", "ENER", "LAMBDA")
_PLACE = ("X", "Y", "Z")
_STOKES = "STOKES"


@dataclass(frozen=True)
class Cube:
    """An image reduced to three axes."""

    part: HDU  # its HDU
    name: str  # field name
    place: str  # its identifier in `fields=`: name or number of the HDU
    axes: tuple[int, ...]  # the three axes of the image; 0 is NAXIS1
    index: tuple[Any, ...]  # index that selects the cube from the array, in NumPy's order

    @property
    def sides(self) -> tuple[int, ...]:
        """Number of pixels along each axis."""
        sides = image_shape(self.part)
        return tuple(sides[axis] for axis in self.axes)

    @property
    def scaling(self) -> Scaling:
        """Conversion from stored numbers to values."""
        return scaling(self.part)

    @property
    def unit(self) -> Any:
        """The astropy unit of the values, or None."""
        return lenient_unit(str(card(self.part.header, "BUNIT", "")))

    def info(self) -> FieldInfo:
        """Return the description of the field, without reading values."""
        sides = image_shape(self.part)[::-1]
        return FieldInfo(
            self.name, self.place, sides, str(self.scaling.dtype), unit_name(self.unit)
        )


def images(found: Iterable[HDU]) -> list[tuple[HDU, list[int]]]:
    """Return all non-empty images, each with its relevant axes.

    Relevant axes have more than one pixel, or are x, y and z in space: a thin slab or a single cell
    may have one pixel along these.
    """
    listed = []
    for part in found:
        if is_image(part) and (sides := image_shape(part)) and min(sides) > 0:
            listed.append((part, [k for k, n in enumerate(sides) if n > 1 or _in_space(part, k)]))
    return listed


def _in_space(part: HDU, axis: int) -> bool:
    return str(card(part.header, f"CTYPE{axis + 1}", "")).strip().upper() in _PLACE


def cubes(found: Sequence[HDU], hdu: Any = None, plane: Any = None) -> list[Cube]:
    """Return the cubes of a file, or of one HDU if it is given."""
    parts = list(found) if hdu is None else [_named(found, hdu)]
    some = [(part, real) for part, real in images(parts) if len(real) >= 3]
    if not some:
        raise FileFormatError(_nothing(images(parts)))
    names, places = _names([part for part, _ in some]), _places([part for part, _ in some])
    return [
        _cube(part, real, name, place, plane)
        for (part, real), name, place in zip(some, names, places, strict=True)
    ]


def _nothing(listed: list[tuple[HDU, list[int]]]) -> str:
    expected = "expected an image with three axes"
    if not listed:
        return f"{expected}; there is no image with values in it"
    flat = ", ".join(f"{p.name}: {' x '.join(map(str, image_shape(p)))}" for p, _ in listed[:8])
    return f"{expected}, found {flat}; vm.Image.load reads images of two axes"


def _named(found: Sequence[HDU], hdu: Any) -> HDU:
    names = {str(part.number): part for part in found}
    names |= {str(card(p.header, "EXTNAME", "")).strip().upper(): p for p in reversed(found)}
    key = str(hdu).strip().upper()
    if key not in names:
        raise unknown_name("HDU", str(hdu), [name for name in names if name])
    return names[key]


def _names(parts: list[HDU]) -> list[str]:
    """Return field names: EXTNAME, else BTYPE, else "intensity"; numbered if equal."""
    names: list[str] = []
    for part in parts:
        name = _name(part)
        name = f"{name}_{part.number}" if name in names else name
        while name in names:
            name += "_"
        names.append(name)
    return names


def _places(parts: list[HDU]) -> list[str]:
    """Return HDU names, or numbers for HDUs with a missing or ambiguous name."""
    titles = [_title(part) for part in parts]
    return [
        title if title and titles.count(title) == 1 else str(part.number)
        for part, title in zip(parts, titles, strict=True)
    ]


def _title(part: HDU) -> str:
    title = str(card(part.header, "EXTNAME", "")).strip()
    return "" if title.upper() in _NAMELESS else title


def _name(part: HDU) -> str:
    kind = str(card(part.header, "BTYPE", "")).strip()
    title = _title(part)
    if title and kind.upper() == title.upper():
        return field_name(kind)  # our original spelling: astropy capitalizes it
    title = title if title and not title.isupper() else (title or kind or "intensity").lower()
    return field_name(title)


def _cube(part: HDU, real: list[int], name: str, place: str, plane: Any) -> Cube:
    sides = image_shape(part)
    if is_compressed(part):
        check_tiles(part)
    axes, others = _three(part, real)
    chosen = _planes(part, others, plane)
    index = tuple(
        slice(None) if k in axes else chosen.get(k, 0) for k in reversed(range(len(sides)))
    )
    return Cube(part, name, place, tuple(axes), index)


def _three(part: HDU, real: list[int]) -> tuple[list[int], list[int]]:
    """Return the axes of the cube (sky and spectrum take precedence), and the other axes."""
    if len(real) == 3:
        return real, []
    kinds = {k: str(card(part.header, f"CTYPE{k + 1}", "")).strip().upper() for k in real}
    known = [k for k in real if kinds[k].startswith((*_SKY, *_SPECTRUM))]
    rest = [k for k in real if k not in known]
    axes = sorted([*known, *sorted(rest, key=lambda k: kinds[k] == _STOKES)][:3])
    return axes, [k for k in real if k not in axes]


def _planes(part: HDU, others: list[int], plane: Any) -> dict[int, int]:
    sides = image_shape(part)
    kinds = [str(card(part.header, f"CTYPE{k + 1}", "")).strip() for k in others]
    if plane is None:
        if any(kind.upper() != _STOKES for kind in kinds):
            listed = ", ".join(
                f"{kind or 'an axis'} of {sides[k]}" for k, kind in zip(others, kinds, strict=True)
            )
            raise InputError(
                f"{part.name} has {3 + len(others)} axes; choose with plane=0 … along {listed}"
            )
        return dict.fromkeys(others, 0)  # the first Stokes parameter: the intensity
    chosen = [plane] if np.ndim(plane) == 0 else list(plane)
    if not others or len(chosen) != len(others):
        raise InputError(
            f"{part.name} has {len(others)} axes beyond three, plane gives {len(chosen)} numbers"
        )
    for k, number in zip(others, chosen, strict=True):
        if not isinstance(number, (int, np.integer)) or not 0 <= number < sides[k]:
            raise InputError(f"plane must be a whole number below {sides[k]}, got {plane!r}")
    return {k: int(number) for k, number in zip(others, chosen, strict=True)}
