"""The slices of a DICOM series: their positions, their order in a volume, and their values."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError, MissingPackageError
from ...packages import require
from ..guard import by_library, reading
from .dicom_file import check_size, is_mosaic, is_native, quiet, read_whole, tiles
from .placement import LPS, Placement
from .voxels import time_step

_MOST_FRAMES = 100_000
# Tags of FrameTime and FrameTimeVector: the frames differ in time.
_FILM = {0x00181063, 0x00181065}
# Candidates: the smallest type that holds all values is used.
_WHOLE = ("u1", "i1", "u2", "i2", "u4", "i4", "i8")
# Slices nearer than this part of the largest distance, or this length in mm, are at one place.
_SAME, _SAME_LENGTH = 0.01, 1e-3
# Directions that differ by more are not parallel.
_PARALLEL = 0.01
# Distances that differ by less are equal, but for rounding.
_EVEN = 0.02


@dataclass(frozen=True)
class DicomSlice:
    """One slice of a series, without its pixels."""

    path: Path
    number: int  # which one of those in the file
    position: np.ndarray  # centre of its first pixel, in mm, LPS; NaN if it has none
    axes: np.ndarray  # unit vectors along a row, and down a column; NaN if it has none
    spacing: tuple[float, ...] | None  # between rows, and between columns, in mm
    thickness: float  # distance to the next slice, as the header claims, or the slice's thickness
    slope: float  # true values are slope · stored + intercept
    intercept: float
    order: int  # its number in the series


def slices_of(path: Path, header: Any) -> list[DicomSlice]:
    """Return the slices in one file: one, or as many as it has frames."""
    count = int(_number(header, "NumberOfFrames", 1))
    if not 1 <= count <= _MOST_FRAMES:
        raise FileFormatError(f"NumberOfFrames must be from 1 to {_MOST_FRAMES}, got {count}")
    check_size(path, header, count)
    shared = [*(header.get("SharedFunctionalGroupsSequence") or ()), header]
    each = list(header.get("PerFrameFunctionalGroupsSequence") or ())
    if each and len(each) != count:
        raise FileFormatError(f"NumberOfFrames is {count}, but {len(each)} frames are described")
    if not each:
        each = [header] if count == 1 else _offset_frames(header, count)
    return [_slice(path, header, number, (own, *shared)) for number, own in enumerate(each)]


def _offset_frames(header: Any, count: int) -> list[Any]:
    """Return stand-ins for the frames of files that only place the first, such as doses."""
    if _FILM & {int(tag) for tag in np.atleast_1d(header.get("FrameIncrementPointer") or 0)}:
        raise FileFormatError(
            f"its {count} frames were taken one after the other (FrameTime): a film, no volume"
        )
    offsets = _numbers(header, "GridFrameOffsetVector")
    first = _numbers(header, "ImagePositionPatient", 3)
    axes = _unit_axes(_numbers(header, "ImageOrientationPatient", 6))
    if offsets is None or first is None or np.isnan(axes).any():
        return [{} for _ in range(count)]
    if len(offsets) != count:
        raise FileFormatError(f"expected {count} offsets of frames, got {len(offsets)}")
    normal = np.cross(*axes)
    return [{"ImagePositionPatient": first + d * normal} for d in offsets - offsets[0]]


def _slice(path: Path, header: Any, number: int, places: tuple[Any, ...]) -> DicomSlice:
    def numbers(sequence: str, keyword: str, count: int) -> np.ndarray | None:
        for place in places:
            inner = place.get(sequence)
            found = _numbers(inner[0] if inner else place, keyword, count)
            if found is not None:
                return found
        return None

    def one(sequence: str, keyword: str, default: float) -> float:
        found = numbers(sequence, keyword, 1)
        return default if found is None else float(found[0])

    measures, values = "PixelMeasuresSequence", "PixelValueTransformationSequence"
    spacing = numbers(measures, "PixelSpacing", 2)
    position = numbers("PlanePositionSequence", "ImagePositionPatient", 3)
    return DicomSlice(
        path,
        number,
        np.full(3, np.nan) if position is None else position,
        _unit_axes(numbers("PlaneOrientationSequence", "ImageOrientationPatient", 6)),
        None if spacing is None else tuple(spacing),
        one(measures, "SpacingBetweenSlices", one(measures, "SliceThickness", 1.0)),
        one(values, "RescaleSlope", _number(header, "DoseGridScaling", 1.0)),
        one(values, "RescaleIntercept", 0.0),
        int(_number(header, "InstanceNumber", 0)),
    )


def _unit_axes(numbers: np.ndarray | None) -> np.ndarray:
    if numbers is None:
        return np.full((2, 3), np.nan)
    axes = numbers.reshape(2, 3)
    lengths = np.linalg.norm(axes, axis=1)
    if not np.allclose(lengths, 1, atol=0.01) or abs(axes[0] @ axes[1]) > 0.01:
        raise FileFormatError(
            f"ImageOrientationPatient must be two unit vectors at right angles, got {numbers}"
        )
    unit: np.ndarray = axes / lengths[:, None]
    return unit


def _numbers(place: Any, keyword: str, count: int | None = None) -> np.ndarray | None:
    value = place.get(keyword)
    if value is None or (isinstance(value, str) and not value):
        return None
    found = np.atleast_1d(np.asarray(value, dtype=float))
    if found.size == 0:
        return None
    if not np.all(np.isfinite(found)) or (count is not None and found.size != count):
        raise FileFormatError(f"{keyword} must be {count or 'finite'} numbers, got {value}")
    return found


def _number(place: Any, keyword: str, default: float) -> float:
    found = _numbers(place, keyword, 1)
    return default if found is None else float(found[0])


def stacked(slices: Sequence[DicomSlice], time: int) -> tuple[list[DicomSlice], Placement, int]:
    """Return slices in order, where they are, and of how many time steps they are one."""
    if any(np.isnan(s.position).any() or np.isnan(s.axes).any() for s in slices):
        time_step(time, 1)
        ordered = sorted(slices, key=lambda s: (s.order, str(s.path), s.number))
        row, column = ordered[0].spacing or (1.0, 1.0)
        steps = np.diag([column, row, abs(ordered[0].thickness) or 1.0])
        return ordered, Placement(np.zeros(3), steps, "mm" if ordered[0].spacing else ""), 1
    along, down = slices[0].axes
    if any(np.max(np.abs(s.axes - slices[0].axes)) > _PARALLEL for s in slices):
        raise FileFormatError(
            "its slices are not parallel (a scout, or a series of views?): they make no volume"
        )
    normal = np.cross(along, down)
    places = _places(slices, normal)
    counts = sorted({len(place) for place in places})
    if len(counts) > 1:
        raise FileFormatError(
            f"expected as many slices at every place, got {counts[0]} to {counts[-1]}: some are "
            "missing, or the directory holds copies"
        )
    step = time_step(time, counts[0])
    chosen = [place[step] for place in places]
    row, column = chosen[0].spacing or (1.0, 1.0)
    along, down = chosen[0].axes
    across, stations = _across(chosen, np.cross(along, down))
    steps = np.array([along * column, down * row, across])
    return chosen, Placement(chosen[0].position, steps, "mm", LPS, stations), counts[0]


def _places(slices: Sequence[DicomSlice], normal: np.ndarray) -> list[list[DicomSlice]]:
    """Return the slices at each place along the normal, each in the order they were taken."""

    def taken(s: DicomSlice) -> tuple[int, int, str]:
        return s.order, s.number, str(s.path)

    pairs = [(float(normal @ s.position), s) for s in slices]
    pairs.sort(key=lambda pair: (pair[0], *taken(pair[1])))
    gaps = np.diff([distance for distance, _ in pairs])
    # With time steps most gaps are none: the largest is of the kind that separates places.
    same = min(_SAME * max(gaps, default=0.0), _SAME_LENGTH)
    places = [[pairs[0][1]]]
    for gap, (_, found) in zip(gaps, pairs[1:], strict=True):
        if gap > same:
            places.append([])
        places[-1].append(found)
    return [sorted(place, key=taken) for place in places]


def _across(slices: Sequence[DicomSlice], normal: np.ndarray) -> tuple[np.ndarray, Any]:
    """Return the mean step between slices, and where they are if they are not even."""
    if len(slices) == 1:
        return normal * (abs(slices[0].thickness) or 1.0), None
    first = slices[0].position
    step = (slices[-1].position - first) / (len(slices) - 1)
    width = float(np.linalg.norm(step))
    stations = np.array([(s.position - first) @ step / width for s in slices])
    gaps = np.diff(stations)
    usual = float(np.median(gaps))
    if np.max(np.abs(gaps - usual)) <= _EVEN * usual:
        return step, None
    wide = int(np.argmax(gaps))
    missing = "slices seem to be missing" if gaps[wide] > 1.5 * usual else "they stay there"
    warnings.warn(
        f"the slices are {gaps.min():g} to {gaps.max():g} mm apart, {usual:g} mm usually, and "
        f"farthest behind slice {wide + 1} of {len(gaps) + 1}: {missing}; cells reach to the "
        "middle between slices",
        stacklevel=2,
    )
    return step, stations


def value_type(header: Any, slices: Sequence[DicomSlice]) -> np.dtype[Any]:
    """Return the type of the true values: integer where slopes and intercepts are whole numbers."""
    if _is_float(header):
        return np.dtype(np.float32 if header.BitsAllocated == 32 else np.float64)
    allocated, stored, high = _bits(header)
    if allocated not in (8, 16, 32) or not 1 <= stored <= high + 1 <= allocated:
        raise FileFormatError(
            f"expected pixels of 8, 16 or 32 bits, got {stored} up to bit {high} of {allocated}"
        )
    numbers = {(s.slope, s.intercept) for s in slices}
    if not all(float(a).is_integer() and float(b).is_integer() for a, b in numbers):
        return np.dtype(np.float32)
    signed = bool(header.get("PixelRepresentation"))
    low, top = (-(1 << stored - 1), (1 << stored - 1) - 1) if signed else (0, (1 << stored) - 1)
    ends = [int(a) * end + int(b) for a, b in numbers for end in (low, top)]
    for code in _WHOLE:
        if np.iinfo(code).min <= min(ends) and max(ends) <= np.iinfo(code).max:
            return np.dtype(code)
    return np.dtype(np.float32)


@quiet()
def read_values(
    slices: Sequence[DicomSlice], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> np.ndarray:
    """Return the values of slices, shape (columns, rows, slices)."""
    out = np.empty(shape[::-1], dtype)
    ordered = sorted(enumerate(slices), key=lambda pair: str(pair[1].path))
    for path, group in groupby(ordered, key=lambda pair: pair[1].path):
        with reading(path, "a DICOM image"), by_library("pydicom"):
            pixels = _stored_pixels(path, shape)
        for k, found in group:
            stored = pixels[found.number]
            if dtype.kind == "f":
                np.multiply(stored, found.slope, out=out[k], casting="unsafe")
                out[k] += dtype.type(found.intercept)
            else:  # the result fits, what is between may not
                out[k] = stored.astype(np.int64) * int(found.slope) + int(found.intercept)
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
    allocated, stored, high = _bits(whole)
    if _is_float(whole) or stored == allocated or not is_native(whole):
        return pixels
    # Without the bits beside them, where old files keep overlays (PS3.5, 8.1.1).
    return pixels << (allocated - 1 - high) >> (allocated - stored)


def _check_decoder(header: Any) -> None:
    """Raise the error that names packages if nothing installed can decode the pixels."""
    syntax = header.file_meta.TransferSyntaxUID
    if is_native(header):
        return
    try:
        decoder = require("pydicom.pixels", "medical", "reading DICOM").get_decoder(syntax)
    except NotImplementedError:
        raise FileFormatError(
            f"its pixels are packed as {syntax.name!r}, which pydicom does not know"
        ) from None
    if not decoder.is_available:
        needed = "; or ".join(decoder.missing_dependencies)
        raise MissingPackageError(
            f"its pixels are packed as {syntax.name!r}, for which pydicom needs another package: "
            f"{needed}. Install one, e.g. pip install pylibjpeg[all]"
        )


def _bits(header: Any) -> tuple[int, int, int]:
    """Return how many bits a pixel has, how many of them count, and the highest of these."""
    allocated = int(header.BitsAllocated)
    stored = int(header.get("BitsStored") or allocated)
    high = header.get("HighBit")
    return allocated, stored, stored - 1 if high is None else int(high)


def _is_float(header: Any) -> bool:
    # Only integers have a representation.
    return header.BitsAllocated in (32, 64) and header.get("PixelRepresentation") is None
