"""RADMC-3D's images: ``image.out`` (text) and ``image.bout`` (binary).

They hold intensities at several wavelengths; with polarization the Stokes parameters I, Q, U and V
of each. The channels are I at all wavelengths, then Q, U and V at all wavelengths.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError, InputError, UnitsError
from ...units import parse_unit, plain
from .contract import Format

if TYPE_CHECKING:
    from ..image import Image

_BINARY = ".bout"
_STOKES = "IQUV"
# Format number → unit of pixels, number of Stokes parameters.
_KINDS = {1: ("cm", 1), 2: ("rad", 1), 3: ("cm", 4), 4: ("rad", 4)}
_INTENSITY = "erg / (s cm2 Hz sr)"
_WAVELENGTHS = "wavelengths_micron"
# Number of integers in the header: format, columns, rows, wavelengths.
_HEAD = 4
# Fortran omits the "E" of exponents with three digits.
_LETTERLESS = re.compile(rb"(?<=[\d.])([+-]\d{3})(?!\d)")


def read(path: Path) -> dict[str, Any]:
    """Read the image, centred on 0: the file contains the pixel size, but no position.

    The provenance holds the wavelengths and the meaning of the channels.
    """
    binary = path.suffix.lower() == _BINARY
    head, numbers = _binary(path) if binary else _text(path)
    shape, waves, (unit, parameters) = _checked(head, len(numbers))
    ny, nx = shape
    size, wavelengths, values = numbers[:2], numbers[2 : 2 + waves], numbers[2 + waves :]
    if binary:  # Stokes planes are consecutive here; in a text they are interleaved
        planes = values.reshape(waves, parameters, ny, nx).transpose(2, 3, 1, 0)
    else:
        planes = values.reshape(waves, ny, nx, parameters).transpose(1, 2, 3, 0)
    x, y = (_centres(n, step) for n, step in ((nx, size[0]), (ny, size[1])))
    names = [f"{s} {w:g} micron" for s in _STOKES[:parameters] for w in wavelengths]
    return {
        "intensity": np.ascontiguousarray(planes, np.float64).reshape(ny, nx, -1),
        "x": x,
        "y": y,
        "unit": unit,
        "pixel_size": size,
        "intensity_unit": _INTENSITY,
        "provenance": {
            _WAVELENGTHS: wavelengths,
            "stokes": _STOKES[:parameters],
            "channels": names,
        },
    }


def _centres(count: int, step: float) -> NDArray[np.float64]:
    centres: NDArray[np.float64] = (np.arange(count, dtype=np.float64) - 0.5 * (count - 1)) * step
    return centres


def _text(path: Path) -> tuple[list[int], NDArray[np.float64]]:
    text = path.read_bytes().replace(b"D", b"E")
    if not text[-1:].isspace():
        raise FileFormatError("it is cut short: its last line does not end")
    tokens = _LETTERLESS.sub(rb"E\1", text).split()
    if len(tokens) < _HEAD:
        raise FileFormatError("it ends within its first lines")
    return [int(token) for token in tokens[:_HEAD]], np.array(tokens[_HEAD:], dtype=np.float64)


def _binary(path: Path) -> tuple[list[int], NDArray[np.float64]]:
    content = path.read_bytes()
    if len(content) < 8 * _HEAD or len(content) % 8:
        raise FileFormatError(f"{len(content)} bytes are no whole numbers of 8 bytes, or too few")
    numbers = np.frombuffer(content, "<f8", offset=8 * _HEAD)
    return np.frombuffer(content, "<i8", _HEAD).tolist(), numbers


def _checked(head: list[int], found: int) -> tuple[tuple[int, int], int, tuple[str, int]]:
    """Return (rows, columns), the number of wavelengths, and the entry of `_KINDS`."""
    number, nx, ny, waves = head
    if number not in _KINDS:
        raise FileFormatError(f"the format number must be 1, 2, 3 or 4, got {number}")
    if min(nx, ny, waves) < 1:
        raise FileFormatError(f"it says {nx} x {ny} pixels and {waves} wavelengths")
    expected = 2 + waves + math.prod((waves, ny, nx, _KINDS[number][1]))
    if found != expected:
        raise FileFormatError(
            f"{nx} x {ny} pixels at {waves} wavelengths make {expected} numbers, found {found}: "
            "it is cut short, or of another kind"
        )
    return (ny, nx), waves, _KINDS[number]


def write(image: Image, path: Path, *, wavelengths: Any = None) -> None:
    """Write the intensities unchanged; the format has no place for other metadata.

    Parameters
    ----------
    image : Image
        Its plane has a unit of length or angle; without a unit cm is assumed.
    path : Path
    wavelengths : float, array_like or Quantity, optional
        Of the channels, in micron. Default: from the provenance of an image read from such a file.
    """
    waves = _wavelengths(image, wavelengths)
    parameters = len((image.provenance or {}).get("stokes", "I"))
    if len(waves) * parameters != image.channels:
        raise InputError(
            f"expected one wavelength for each of {image.channels // parameters} channels, got "
            f"{len(waves)}"
        )
    angle, size = _pixel_size(image)
    ny, nx, _ = image.shape
    head = [1 + angle + 2 * (parameters == 4), nx, ny, len(waves)]
    values = image.intensity.astype(np.float64).reshape(ny, nx, parameters, len(waves))
    with path.open("wb") as file:
        if path.suffix.lower() == _BINARY:
            file.write(np.array(head, "<i8").tobytes())
            file.write(np.concatenate([size, waves]).astype("<f8").tobytes())
            file.write(values.transpose(3, 2, 0, 1).astype("<f8").tobytes())
        else:
            numbers = "{}\n{} {}\n{}\n".format(*head) + f"{size[0]!r} {size[1]!r}\n"
            file.write((numbers + "".join(f"{wave!r}\n" for wave in waves) + "\n").encode())
            line = " ".join(["%.16e"] * parameters) + "\n"
            for plane in values.transpose(3, 0, 1, 2).reshape(len(waves), -1):
                file.write((line * (nx * ny) % tuple(plane.tolist()) + "\n").encode())


def _wavelengths(image: Image, given: Any) -> list[float]:
    known = (image.provenance or {}).get(_WAVELENGTHS)
    if given is None and known is None:
        raise InputError(
            "RADMC-3D's images have wavelengths; give that of each channel in micron, such as "
            "image.save('image.out', wavelengths=[1300, 870])"
        )
    chosen = known if given is None else plain(given, "micron", "wavelengths")
    waves: list[float] = np.atleast_1d(np.asarray(chosen, np.float64)).tolist()
    if not all(math.isfinite(wave) and wave > 0 for wave in waves):
        raise InputError(f"wavelengths must be positive and finite, got {chosen!r}")
    return waves


def _pixel_size(image: Image) -> tuple[bool, tuple[float, float]]:
    """Return True if pixels are angles, and their width and height in cm or radian."""
    unit = parse_unit(image.unit or "cm")
    for angle, name in enumerate(("cm", "rad")):
        if unit.is_equivalent(name):
            factor = 1.0 if unit == parse_unit(name) else float(unit.to(name))
            return bool(angle), (image.pixel_size[0] * factor, image.pixel_size[1] * factor)
    raise UnitsError(f"the image plane is in {image.unit}, expected a length or an angle")


_OPTIONS = frozenset({"wavelengths"})
TEXT = Format(
    "a RADMC-3D image (image.out)",
    (".out",),
    (b" ", b"\n", b"\r", b"\t", *(str(number).encode() for number in _KINDS)),
    write,
    read,
    _OPTIONS,
)
BINARY = Format(
    "a RADMC-3D image (image.bout)",
    (_BINARY,),
    tuple(number.to_bytes(8, "little") for number in _KINDS),
    write,
    read,
    _OPTIONS,
)
