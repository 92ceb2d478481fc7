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
# What differs between frames: FrameTime or FrameTimeVector.
_FILM = {0x00181063, 0x00181065}


@dataclass(frozen=True)
class Frame:
    """One slice of a series."""

    path: Path  # the file it is in
    number: int  # which one of those in the file
    position: np.ndarray | None  # centre of its first pixel, in mm, LPS
    axes: np.ndarray | None  # unit vectors along a row, and down a column
    spacing: tuple[float, ...] | None  # distance between rows, and between columns, in mm
    thickness: float  # distance to the next slice, as the head claims, or the slice's thickness
    slope: float  # true values are slope · stored + intercept
    intercept: float  # true values are slope · stored + intercept
    order: int  # its number in the series


def frames_of(path: Path, head: Any) -> list[Frame]:
    """Return the slices in one file: one, or as many as it has frames."""
    count = _whole(head, "NumberOfFrames", 1)
    if not 1 <= count <= _MOST_FRAMES:
        raise FileFormatError(f"NumberOfFrames must be from 1 to {_MOST_FRAMES}, got {count}")
    check_size(path, head, count)
    shared, each = _groups(head, count)
    return [_frame(path, head, number, (own, *shared)) for number, own in enumerate(each)]


def _groups(head: Any, count: int) -> tuple[list[Any], list[Any]]:
    shared = [*(head.get("SharedFunctionalGroupsSequence") or ()), head]
    each = list(head.get("PerFrameFunctionalGroupsSequence") or ())
    if not each and count > 1:
        return shared, _offset_frames(head, count)
    if each and len(each) != count:
        raise FileFormatError(f"NumberOfFrames is {count}, but {len(each)} frames are described")
    return shared, each or [head]


def _offset_frames(head: Any, count: int) -> list[Any]:
    """Return stand-ins for the frames of files that tell where the first is: doses, for one."""
    if _FILM & {int(tag) for tag in np.atleast_1d(head.get("FrameIncrementPointer") or 0)}:
        raise FileFormatError(
            f"its {count} frames were taken one after the other (FrameTime): a film, no volume"
        )
    offsets = _numbers(head, "GridFrameOffsetVector")
    first, axes = _numbers(head, "ImagePositionPatient", 3), _axes(head)
    if offsets is None or first is None or axes is None:
        return [{} for _ in range(count)]
    if len(offsets) != count:
        raise FileFormatError(f"expected {count} offsets of frames, got {len(offsets)}")
    normal = np.cross(*axes)
    return [{"ImagePositionPatient": first + d * normal} for d in offsets - offsets[0]]


def _frame(path: Path, head: Any, number: int, places: tuple[Any, ...]) -> Frame:
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

    measures, plane = "PixelMeasuresSequence", "PlaneOrientationSequence"
    spacing = numbers(measures, "PixelSpacing", 2)
    values = "PixelValueTransformationSequence"
    thickness = one(measures, "SliceThickness", 1.0)
    dose = _numbers(head, "DoseGridScaling", 1)
    return Frame(
        path,
        number,
        numbers("PlanePositionSequence", "ImagePositionPatient", 3),
        _unit_axes(numbers(plane, "ImageOrientationPatient", 6)),
        None if spacing is None else tuple(spacing),
        one(measures, "SpacingBetweenSlices", thickness),
        one(values, "RescaleSlope", 1.0 if dose is None else float(dose[0])),
        one(values, "RescaleIntercept", 0.0),
        _whole(head, "InstanceNumber", 0),
    )


def _axes(head: Any) -> np.ndarray | None:
    return _unit_axes(_numbers(head, "ImageOrientationPatient", 6))


def _unit_axes(numbers: np.ndarray | None) -> np.ndarray | None:
    if numbers is None:
        return None
    axes = numbers.reshape(2, 3)
    lengths = np.linalg.norm(axes, axis=1)
    if not np.allclose(lengths, 1, atol=0.01) or abs(axes[0] @ axes[1]) > 0.01:
        raise FileFormatError(
            f"ImageOrientationPatient must be two unit vectors at right angles, got {numbers}"
        )
    return axes / lengths[:, None]


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


def _whole(head: Any, keyword: str, default: int) -> int:
    found = _numbers(head, keyword, 1)
    return default if found is None else int(found[0])


# The smallest of these that holds all values is taken.
_WHOLE = ("u1", "i1", "u2", "i2", "u4", "i4", "i8")


def value_type(head: Any, frames: Sequence[Frame]) -> np.dtype[Any]:
    """Return the type of the true values: integer where slopes and intercepts are whole numbers."""
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


# Slices nearer than this part of the largest distance, or this length in mm, are at one place.
_SAME, _SAME_LENGTH = 0.01, 1e-3
# Directions that differ by more are not parallel.
_PARALLEL = 0.01
# Distances that differ by less are equal, but for rounding.
_EVEN = 0.02


def stacked(frames: Sequence[Frame], time: int) -> tuple[list[Frame], Placement, int]:
    """Return slices in order, where they are, and of how many time steps they are one."""
    if any(f.position is None or f.axes is None for f in frames):
        return _in_file_order(frames, time)
    _check_parallel(frames)
    normal = np.cross(*_dicom_stack_axes(frames[0]))
    distances = [float(normal @ _position(frame)) for frame in frames]
    places = _places(frames, distances)
    times = len(places[0])
    if any(len(place) != times for place in places):
        counts = sorted({len(place) for place in places})
        raise FileFormatError(
            f"expected as many slices at every place, got {counts[0]} to {counts[-1]}: some are "
            "missing, or the directory holds copies"
        )
    step = time_step(time, times)
    chosen = [place[step] for place in places]
    return chosen, _placement(chosen), times


def _in_file_order(frames: Sequence[Frame], time: int) -> tuple[list[Frame], Placement, int]:
    time_step(time, 1)
    ordered = sorted(frames, key=lambda f: (f.order, str(f.path), f.number))
    row, column = ordered[0].spacing or (1.0, 1.0)
    unit = "mm" if ordered[0].spacing else ""
    steps = np.diag([column, row, abs(ordered[0].thickness) or 1.0])
    return ordered, Placement(np.zeros(3), steps, unit), 1


def _check_parallel(frames: Sequence[Frame]) -> None:
    first = _dicom_stack_axes(frames[0])
    if any(np.max(np.abs(_dicom_stack_axes(f) - first)) > _PARALLEL for f in frames):
        raise FileFormatError(
            "its slices are not parallel (a scout, or a series of views?): they make no volume"
        )


def _places(frames: Sequence[Frame], distances: Sequence[float]) -> list[list[Frame]]:
    """Return the slices at each place along the normal, each in the order they were taken."""
    ordered = sorted(
        zip(distances, frames, strict=True),
        key=lambda pair: (pair[0], pair[1].order, pair[1].number, str(pair[1].path)),
    )
    gaps = np.diff([distance for distance, _ in ordered])
    # With time steps most gaps are none: the largest is of the kind that separates places.
    same = min(_SAME * max(gaps, default=0.0), _SAME_LENGTH)
    places = [[ordered[0][1]]]
    for gap, (_, frame) in zip(gaps, ordered[1:], strict=True):
        if gap > same:
            places.append([])
        places[-1].append(frame)
    return [sorted(place, key=lambda f: (f.order, f.number, str(f.path))) for place in places]


def _placement(frames: Sequence[Frame]) -> Placement:
    along, down = _dicom_stack_axes(frames[0])
    row, column = frames[0].spacing or (1.0, 1.0)
    first = _position(frames[0])
    across, stations = _across(frames, np.cross(along, down))
    return Placement(first, [along * column, down * row, across], "mm", LPS, stations)


def _across(frames: Sequence[Frame], normal: np.ndarray) -> tuple[np.ndarray, Any]:
    """Return the mean step between slices, and where they are if they are not even."""
    if len(frames) == 1:
        return normal * (abs(frames[0].thickness) or 1.0), None
    first, last = _position(frames[0]), _position(frames[-1])
    step = (last - first) / (len(frames) - 1)
    width = float(np.linalg.norm(step))
    stations = np.array([(_position(f) - first) @ step / width for f in frames])
    gaps = np.diff(stations)
    usual = float(np.median(gaps))
    if np.max(np.abs(gaps - usual)) <= _EVEN * usual:
        return step, None
    _warn_of_gaps(gaps, usual)
    return step, stations


def _warn_of_gaps(gaps: np.ndarray, usual: float) -> None:
    wide = int(np.argmax(gaps))
    missing = "slices seem to be missing" if gaps[wide] > 1.5 * usual else "they are kept so"
    warnings.warn(
        f"the slices are {gaps.min():g} to {gaps.max():g} mm apart, {usual:g} mm usually, and "
        f"farthest behind slice {wide + 1} of {len(gaps) + 1}: {missing}; cells reach to the "
        "middle between slices",
        stacklevel=2,
    )


def _position(frame: Frame) -> np.ndarray:
    assert frame.position is not None
    return frame.position


def _dicom_stack_axes(frame: Frame) -> np.ndarray:
    assert frame.axes is not None
    return frame.axes
