"""The slices of a DICOM series: what the head of a file tells of each, without its pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from .dicom_file import check_size

_MOST_FRAMES = 100_000
# What differs between frames: FrameTime or FrameTimeVector.
_FILM = {0x00181063, 0x00181065}


@dataclass(frozen=True)
class Frame:
    """One slice of a series.

    Attributes
    ----------
    path : Path
        The file it is in.
    number : int
        Which one of those in the file.
    position : array, shape (3,), or None
        Centre of its first pixel, in mm, LPS.
    axes : array, shape (2, 3), or None
        Unit vectors along a row, and down a column.
    spacing : tuple of float, or None
        Distance between rows, and between columns, in mm.
    thickness : float
        Distance to the next slice, as the head claims, or the slice's thickness.
    slope, intercept : float
        True values are slope · stored + intercept.
    order : int
        Its number in the series.
    """

    path: Path
    number: int
    position: np.ndarray | None
    axes: np.ndarray | None
    spacing: tuple[float, ...] | None
    thickness: float
    slope: float
    intercept: float
    order: int


def frames_of(path: Path, head: Any) -> list[Frame]:
    """Return the slices in one file: one, or as many as it has frames.

    Raises
    ------
    FileFormatError
        If the head contradicts itself.
    """
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
