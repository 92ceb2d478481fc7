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

from ...errors import FileFormatError, InputError, UnitsError
from ...units import parse_unit, plain
from ..cube import Cube
from ..spectral_axis import SpectralAxis

if TYPE_CHECKING:
    from ..image import Image

PARSEC = 3.08572e18
"""RADMC-3D's parsec in cm, at which its spectra are."""
FLUX = "erg / (s cm2 Hz)"
"""The unit of its spectra."""
_BINARY, _STOKES = ".bout", "IQUV"
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
    content, binary = path.read_bytes(), path.suffix.lower() == _BINARY
    if binary:
        head = np.frombuffer(content, "<i8", _HEAD).tolist()
        numbers = np.frombuffer(content, "<f8", offset=8 * _HEAD)
    else:
        tokens = _tokens(content)
        head = [int(token) for token in tokens[:_HEAD]]
        numbers = np.array(tokens[_HEAD:], dtype=np.float64)
    number, nx, ny, waves = head
    if number not in _KINDS or min(nx, ny, waves) < 1:
        raise FileFormatError(
            f"it says format {number}, {nx} x {ny} pixels and {waves} wavelengths; the format "
            "number must be 1, 2, 3 or 4"
        )
    unit, parameters = _KINDS[number]
    expected = 2 + waves + waves * ny * nx * parameters
    if len(numbers) != expected:
        raise FileFormatError(
            f"{nx} x {ny} pixels at {waves} wavelengths make {expected} numbers, found "
            f"{len(numbers)}: it is cut short, or of another kind"
        )
    size, wavelengths, values = numbers[:2], numbers[2 : 2 + waves], numbers[2 + waves :]
    if binary:  # Stokes planes are consecutive here; in a text they are interleaved
        planes = values.reshape(waves, parameters, ny, nx).transpose(2, 3, 1, 0)
    else:
        planes = values.reshape(waves, ny, nx, parameters).transpose(1, 2, 3, 0)
    x, y = ((np.arange(n) - 0.5 * (n - 1)) * step for n, step in zip((nx, ny), size, strict=True))
    stokes = _STOKES[:parameters]
    spectral = {} if parameters > 1 else {"spectral": SpectralAxis(wavelengths, "micron")}
    return {
        **spectral,
        "intensity": np.ascontiguousarray(planes, np.float64).reshape(ny, nx, -1),
        "x": x,
        "y": y,
        "unit": unit,
        "pixel_size": size,
        "intensity_unit": _INTENSITY,
        "provenance": {
            _WAVELENGTHS: wavelengths,
            "stokes": stokes,
            "channels": [f"{s} {w:g} micron" for s in stokes for w in wavelengths],
        },
    }


def _tokens(content: bytes) -> list[bytes]:
    if not content[-1:].isspace():
        raise FileFormatError("it is cut short: its last line does not end")
    return _LETTERLESS.sub(rb"E\1", content.replace(b"D", b"E")).split()


def write(image: Image, path: Path, *, wavelengths: Any = None) -> None:
    """Write the intensities unchanged; the format has no place for other metadata.

    `wavelengths` (micron) are those of the channels, by default those of a cube, or in the
    provenance of an image read from such a file. A plane without a unit is in cm.
    """
    provenance = image.provenance or {}
    if wavelengths is None and isinstance(image, Cube):
        wavelengths = image.spectral.wavelengths
    if wavelengths is None and _WAVELENGTHS not in provenance:
        raise InputError(
            "RADMC-3D's images have wavelengths; give that of each channel in micron, such as "
            "image.save('image.out', wavelengths=[1300, 870])"
        )
    given = provenance[_WAVELENGTHS] if wavelengths is None else wavelengths
    waves = np.atleast_1d(np.asarray(plain(given, "micron", "wavelengths"), np.float64)).tolist()
    if not all(math.isfinite(wave) and wave > 0 for wave in waves):
        raise InputError(f"wavelengths must be positive and finite, got {given!r}")
    parameters = len(provenance.get("stokes", "I"))
    if len(waves) * parameters != image.channels:
        raise InputError(
            f"expected one wavelength for each of {image.channels // parameters} channels, got "
            f"{len(waves)}"
        )
    unit = parse_unit(image.unit or "cm")
    target = next((name for name in ("cm", "rad") if unit.is_equivalent(name)), None)
    if target is None:
        raise UnitsError(f"the image plane is in {image.unit}, expected a length or an angle")
    size = [float(plain(side * unit, target, "pixel_size")) for side in image.pixel_size]
    ny, nx, _ = image.shape
    head = [1 + (target == "rad") + 2 * (parameters == 4), nx, ny, len(waves)]
    values = image.intensity.astype(np.float64).reshape(ny, nx, parameters, len(waves))
    with path.open("wb") as file:
        if path.suffix.lower() == _BINARY:
            file.write(np.array(head, "<i8").tobytes())
            file.write(np.concatenate([size, waves]).astype("<f8").tobytes())
            file.write(values.transpose(3, 2, 0, 1).astype("<f8").tobytes())
        else:
            lines = ["{}\n{} {}\n{}".format(*head), f"{size[0]!r} {size[1]!r}", *map(repr, waves)]
            file.write(("\n".join(lines) + "\n\n").encode())
            line = " ".join(["%.16e"] * parameters) + "\n"
            for plane in values.transpose(3, 0, 1, 2).reshape(len(waves), -1):
                file.write((line * (nx * ny) % tuple(plane.tolist()) + "\n").encode())


def write_spectrum(path: Path, wavelengths: np.ndarray, fluxes: np.ndarray) -> None:
    """Write ``spectrum.out``: wavelengths in micron, and fluxes at 1 pc."""
    rows = [f"{wave:21.13e}{flux:22.13e}" for wave, flux in zip(wavelengths, fluxes, strict=True)]
    path.write_text("\n".join(["1", str(len(rows)), "", *rows]) + "\n")


def read_spectrum(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return wavelengths in micron and fluxes at 1 pc of ``spectrum.out``."""
    number, count, *numbers = _tokens(path.read_bytes()) or [b"0", b"0"]
    if number != b"1" or len(numbers) != 2 * int(count):
        raise FileFormatError(
            f"expected format 1 and {int(count)} wavelengths with a flux each, got format "
            f"{number.decode('ascii', 'replace')} and {len(numbers)} numbers"
        )
    wavelengths, fluxes = np.array(numbers, dtype=np.float64).reshape(-1, 2).T
    return wavelengths, fluxes
