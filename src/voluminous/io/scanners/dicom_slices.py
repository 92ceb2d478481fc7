"""The slices of a DICOM series: their positions, their order in a volume, and their values."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...memory import check_memory
from ...packages import require
from ..guard import by_library, reading
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
    count = int(header.get("NumberOfFrames") or 1)
    if not 1 <= count <= _MOST_FRAMES:
        raise FileFormatError(f"NumberOfFrames must be from 1 to {_MOST_FRAMES}, got {count}")
    frames = list(header.get("PerFrameFunctionalGroupsSequence") or ())
    frames = frames or ([header] if count == 1 else _offset_frames(header, count))
    if len(frames) != count:
        raise FileFormatError(f"NumberOfFrames is {count}, but {len(frames)} frames are described")
    shared = [*(header.get("SharedFunctionalGroupsSequence") or ()), header]
    return [_slice(path, header, number, [frame, *shared]) for number, frame in enumerate(frames)]


def _offset_frames(header: Any, count: int) -> list[Any]:
    if _FILM & {int(tag) for tag in np.atleast_1d(header.get("FrameIncrementPointer") or 0)}:
        raise FileFormatError(
            f"its {count} frames were taken one after the other (FrameTime): a film, no volume"
        )
    offsets = np.asarray(header.get("GridFrameOffsetVector") or (), float)
    first = _numbers([header], "", "ImagePositionPatient", 3)
    axes = _numbers([header], "", "ImageOrientationPatient", 6)
    if not offsets.size or first is None or axes is None:
        return [{}] * count
    normal = np.cross(*_unit_axes(axes))
    return [{"ImagePositionPatient": first + d * normal} for d in offsets - offsets[0]]


def _slice(path: Path, header: Any, number: int, places: list[Any]) -> DicomSlice:
    def one(sequence: str, keyword: str, default: float) -> float:
        numbers = _numbers(places, sequence, keyword, 1)
        return default if numbers is None else float(numbers[0])

    measures, values = "PixelMeasuresSequence", "PixelValueTransformationSequence"
    spacing = _numbers(places, measures, "PixelSpacing", 2)
    position = _numbers(places, "PlanePositionSequence", "ImagePositionPatient", 3)
    axes = _numbers(places, "PlaneOrientationSequence", "ImageOrientationPatient", 6)
    return DicomSlice(
        path,
        number,
        np.full(3, np.nan) if position is None else position,
        np.full((2, 3), np.nan) if axes is None else _unit_axes(axes),
        None if spacing is None else tuple(spacing),
        one(measures, "SpacingBetweenSlices", one(measures, "SliceThickness", 1.0)),
        one(values, "RescaleSlope", float(header.get("DoseGridScaling") or 1.0)),
        one(values, "RescaleIntercept", 0.0),
        int(header.get("InstanceNumber") or 0),
    )


def _unit_axes(numbers: np.ndarray) -> np.ndarray:
    axes = numbers.reshape(2, 3)
    lengths = np.linalg.norm(axes, axis=1)
    if not np.allclose(lengths, 1, atol=0.01) or abs(axes[0] @ axes[1]) > 0.01:
        raise FileFormatError(
            f"ImageOrientationPatient must be two unit vectors at right angles, got {numbers}"
        )
    unit: np.ndarray = axes / lengths[:, None]
    return unit


def _numbers(places: list[Any], sequence: str, keyword: str, count: int) -> np.ndarray | None:
    for place in places:
        inner = place.get(sequence) if sequence else None
        value = (inner[0] if inner else place).get(keyword)
        if value is None or str(value) in ("", "[]"):
            continue
        numbers = np.atleast_1d(np.asarray(value, float))
        if numbers.shape != (count,) or not np.isfinite(numbers).all():
            raise FileFormatError(f"{keyword} must be {count} numbers, got {value}")
        return numbers
    return None


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
    places = _places(slices, np.cross(along, down))
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
    def taken(s: DicomSlice) -> tuple[int, int, str]:
        return s.order, s.number, str(s.path)

    pairs = sorted(
        ((float(normal @ s.position), s) for s in slices), key=lambda p: (p[0], *taken(p[1]))
    )
    gaps = np.diff([distance for distance, _ in pairs])
    # With time steps most gaps are none: the largest is of the kind that separates places.
    same = min(_SAME * max(gaps, default=0.0), _SAME_LENGTH)
    starts = [0, *(np.flatnonzero(gaps > same) + 1), len(pairs)]
    places = [[s for _, s in pairs[a:b]] for a, b in pairwise(starts)]
    return [sorted(place, key=taken) for place in places]


def _across(slices: Sequence[DicomSlice], normal: np.ndarray) -> tuple[np.ndarray, Any]:
    if len(slices) == 1:
        return normal * (abs(slices[0].thickness) or 1.0), None
    first = slices[0].position
    step = (slices[-1].position - first) / (len(slices) - 1)
    stations = np.array([(s.position - first) @ step for s in slices]) / np.linalg.norm(step)
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
    # Only integers have a representation.
    if header.BitsAllocated in (32, 64) and header.get("PixelRepresentation") is None:
        return np.dtype(np.float32 if header.BitsAllocated == 32 else np.float64)
    stored = int(header.get("BitsStored") or header.BitsAllocated)
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


def read_values(
    slices: Sequence[DicomSlice], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> np.ndarray:
    """Return the values of slices, shape (columns, rows, slices)."""
    check_memory(math.prod(shape) * dtype.itemsize, "reading the slices", "are sizes right?")
    pydicom = require("pydicom", "medical", "reading DICOM")
    out = np.empty(shape[::-1], dtype)
    ordered = sorted(enumerate(slices), key=lambda pair: str(pair[1].path))
    for path, group in groupby(ordered, key=lambda pair: pair[1].path):
        with reading(path, "a DICOM image"), by_library("pydicom"):
            pixels = np.asarray(pydicom.dcmread(path).pixel_array).reshape(-1, *shape[1::-1])
            for k, part in group:
                stored = pixels[part.number]
                if dtype.kind == "f":
                    np.multiply(stored, part.slope, out=out[k], casting="unsafe")
                    out[k] += dtype.type(part.intercept)
                else:  # the result fits, what is between may not
                    out[k] = stored.astype(np.int64) * int(part.slope) + int(part.intercept)
    return np.asarray(out.transpose())
