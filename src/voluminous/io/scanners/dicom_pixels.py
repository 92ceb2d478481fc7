"""The values of a DICOM series: stored bits, made Hounsfield units or what else they stand for."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError, MissingPackageError
from ...packages import require
from ..guard import reading
from .dicom_file import is_native, quiet, read_whole
from .dicom_frames import Frame
from .dicom_mosaic import is_mosaic, tiles
from .heads import by_library

# The smallest of these that holds all values is taken.
_WHOLE = ("u1", "i1", "u2", "i2", "u4", "i4", "i8")


def value_type(head: Any, frames: Sequence[Frame]) -> np.dtype[Any]:
    """Return the type of the true values: integer where slopes and intercepts are whole numbers.

    Raises
    ------
    FileFormatError
        If the bits of a pixel make no number.
    """
    if _is_float(head):
        return np.dtype(np.float32 if head.BitsAllocated == 32 else np.float64)
    allocated, stored, high, signed = _bits(head)
    if allocated not in (8, 16, 32) or not 1 <= stored <= high + 1 <= allocated:
        raise FileFormatError(
            f"expected pixels of 8, 16 or 32 bits, got {stored} up to bit {high} of {allocated}"
        )
    numbers = {(frame.slope, frame.intercept) for frame in frames}
    if not all(float(a).is_integer() and float(b).is_integer() for a, b in numbers):
        return np.dtype(np.float32)
    low, top = (-(1 << stored - 1), (1 << stored - 1) - 1) if signed else (0, (1 << stored) - 1)
    ends = [int(a) * end + int(b) for a, b in numbers for end in (low, top)]
    for code in _WHOLE:
        if np.iinfo(code).min <= min(ends) and max(ends) <= np.iinfo(code).max:
            return np.dtype(code)
    return np.dtype(np.float32)


@quiet()
def read_values(frames: Sequence[Frame], shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """Return the values of slices, shape (columns, rows, slices)."""
    out = np.empty(shape[::-1], dtype)
    ordered = sorted(enumerate(frames), key=lambda pair: str(pair[1].path))
    for path, group in groupby(ordered, key=lambda pair: pair[1].path):
        with reading(path, "a DICOM image"), by_library("pydicom"):
            stored = _stored_pixels(path, shape)
        for k, frame in group:
            _rescale(stored[frame.number], frame, out[k])
    return out.transpose()


def _stored_pixels(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    whole = read_whole(path)
    _check_decoder(whole)
    pixels = np.asarray(whole.pixel_array)
    if is_mosaic(whole):
        pixels = tiles(pixels, shape[1::-1])
    pixels = pixels if pixels.ndim == 3 else pixels[None]
    if pixels.shape[1:] != shape[1::-1]:
        raise FileFormatError(
            f"{path.name} holds pixels of shape {pixels.shape}, expected {shape[1::-1]}"
        )
    return pixels if _is_float(whole) else _only_stored(pixels, whole)


def _only_stored(pixels: np.ndarray, head: Any) -> np.ndarray:
    """Return pixels without the bits beside them, where old files keep overlays (PS3.5, 8.1.1)."""
    allocated, stored, high, _ = _bits(head)
    if stored == allocated or not is_native(head):
        return pixels
    return pixels << (allocated - 1 - high) >> (allocated - stored)


def _rescale(stored: np.ndarray, frame: Frame, out: np.ndarray) -> None:
    if out.dtype.kind == "f":
        np.multiply(stored, frame.slope, out=out, casting="unsafe")
        out += out.dtype.type(frame.intercept)
    else:
        # The result fits, what is between may not.
        out[...] = stored.astype(np.int64) * int(frame.slope) + int(frame.intercept)


def _check_decoder(head: Any) -> None:
    """Raise the error that names packages if nothing installed can decode the pixels."""
    syntax = head.file_meta.TransferSyntaxUID
    if is_native(head):
        return
    decoders = require("pydicom.pixels", "medical", "reading DICOM")
    try:
        decoder = decoders.get_decoder(syntax)
    except NotImplementedError:
        raise FileFormatError(
            f"its pixels are packed as {syntax.name!r}, which is not known"
        ) from None
    if not decoder.is_available:
        needed = "; or ".join(decoder.missing_dependencies)
        raise MissingPackageError(
            f"its pixels are packed as {syntax.name!r}, for which pydicom needs another package: "
            f"{needed}. Install one, e.g. pip install pylibjpeg[all]"
        )


def _bits(head: Any) -> tuple[int, int, int, bool]:
    """Return how many bits there are, how many count, the highest, and whether there is a sign."""
    allocated = int(head.BitsAllocated)
    stored = int(head.get("BitsStored") or allocated)
    high = head.get("HighBit")
    return allocated, stored, stored - 1 if high is None else int(high), _is_signed(head)


def _is_signed(head: Any) -> bool:
    return bool(head.get("PixelRepresentation"))


def _is_float(head: Any) -> bool:
    # Only integers have a representation.
    return head.BitsAllocated in (32, 64) and head.get("PixelRepresentation") is None
