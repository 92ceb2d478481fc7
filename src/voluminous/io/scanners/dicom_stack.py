"""From the slices of a series to voxels: sorted by where they are, not by their names."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...errors import FileFormatError
from .dicom_frames import Frame
from .placement import LPS, Placement
from .voxels import time_step

# Slices nearer than this part of the largest distance, or this length in mm, are at one place.
_SAME, _SAME_LENGTH = 0.01, 1e-3
# Directions that differ by more are not parallel.
_PARALLEL = 0.01
# Distances that differ by less are equal, but for rounding.
_EVEN = 0.02


def stacked(frames: Sequence[Frame], time: int) -> tuple[list[Frame], Placement, int]:
    """Return slices in order, where they are, and of how many time steps they are one.

    Raises
    ------
    FileFormatError
        If they make no volume.
    """
    if any(f.position is None or f.axes is None for f in frames):
        return _in_file_order(frames, time)
    _check_parallel(frames)
    normal = np.cross(*_axes(frames[0]))
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
    first = _axes(frames[0])
    if any(np.max(np.abs(_axes(f) - first)) > _PARALLEL for f in frames):
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
    along, down = _axes(frames[0])
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


def _axes(frame: Frame) -> np.ndarray:
    assert frame.axes is not None
    return frame.axes
