"""Several files as one volume: fields side by side, those of other grids resampled."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..calibration.labels import counted
from ..deferred import Deferred
from ..errors import InputError
from ..expressions import Expression
from ..files import as_path
from ..grids import CartesianGrid
from ..units import unit_name
from ..volume import Volume
from .names import field_name
from .scanners.label_tables import SUFFIXES, read_label_table
from .scanners.placement import direction_of
from .scanners.voxels import stem

# Walls that differ by less, in cells, are the same: headers have few digits.
_SAME = 0.01
# Places along each axis at which volumes are compared to find whether they overlap.
_FEW = 24


def open_together(paths: Sequence[Any], fields: Any = None, **options: Any) -> Volume:
    """Return one volume of several files: the fields of all, on the grid of the first.

    Tables of labels (``.ctbl``, ``.lut``, ``.label``, ``.txt``) belong to the file before them.

    Raises
    ------
    InputError
        If grids differ and cannot be resampled, or two volumes do not overlap.
    """
    from .registry import open_lazily

    files = [as_path(path) for path in paths]
    tables = [file for file in files if file.suffix.lower() in SUFFIXES]
    volumes = [file for file in files if file not in tables]
    if not volumes:
        raise InputError(f"expected a file with a volume, got {', '.join(map(str, files))}")
    whole = _with_labels(open_lazily(volumes[0], **options))
    of_file = {volumes[0]: list(whole.fields)}
    notes = []
    for file in volumes[1:]:
        other = _with_labels(open_lazily(file, **options))
        names = of_file[file] = [_free(name, file, whole) for name in other.fields]
        if not (same := _is_same(whole, other)):
            notes.append(_check_overlap(whole, other, volumes[0], file))
        for old, new in zip(other.fields, names, strict=True):
            dtype, nearest = _dtype(other, old), old in other.meta.get("labels", ())
            load = functools.partial(other.array, old)
            if not same:
                dtype = dtype if nearest else np.result_type(dtype, np.float32)
                load = functools.partial(_resampled, whole, other, old, nearest, dtype)
            whole[new] = Deferred(load, dtype, other.field_unit(old))
            for key in ("labels", "channels"):
                if old in other.meta.get(key, ()):
                    whole.meta.setdefault(key, {})[new] = other.meta[key][old]
    for file in tables:
        before = [one for one in files[: files.index(file)] if one in of_file] or volumes[:1]
        of = of_file[before[-1]]
        known = [name for name in of if name in whole.meta.get("labels", ())]
        whole.meta.setdefault("labels", {})[(known or of)[0]] = read_label_table(file)
    if len(volumes) > 1:
        notes.insert(0, f"one volume of {len(volumes)} files: {', '.join(whole.fields)}")
    whole.meta |= {"notes": notes} if notes else {}
    whole.own()
    return _chosen(whole, fields)


def _dtype(volume: Volume, name: str) -> np.dtype[Any]:
    dtype: np.dtype[Any] = np.dtype(volume.describe()["fields"][name]["dtype"])
    return dtype


def _with_labels(volume: Volume) -> Volume:
    """Return the volume, its meta with an empty table for labels that have none."""
    for name in volume.fields:
        if _dtype(volume, name).kind in "iub" and name not in volume.meta.get("labels", ()):
            found = counted(volume, Expression(name))
            if found is not None and len(found[0]) > 1:
                volume.meta.setdefault("labels", {})[name] = []
    return volume


def _free(name: str, file: Path, whole: Volume) -> str:
    """Return a name for a field that the volume does not have yet."""
    tried = [name, field_name(f"{stem(file)}_{name}"), *(f"{name}_{k}" for k in range(2, 100))]
    return next(one for one in tried if one not in whole.fields)


def _is_same(whole: Volume, other: Volume) -> bool:
    a, b = whole.grid, other.grid
    if not (isinstance(a, CartesianGrid) and isinstance(b, CartesianGrid)):
        return bool(a == b)
    if a.shape != b.shape or not np.allclose(direction_of(whole), direction_of(other), atol=1e-3):
        return False
    edges = zip(a.edges, b.edges, strict=True)
    scale = _factor(whole, other)
    return all(np.all(np.abs(x * scale - y) < _SAME * np.diff(y).min()) for x, y in edges)


def _factor(whole: Volume, other: Volume) -> float:
    """Return the other volume's number for a length of 1; 1 where a unit is not given."""
    units = whole.grid.unit, other.grid.unit
    return 1.0 if None in units else float(units[0].to(units[1]))


def _places(whole: Volume, other: Volume, points: np.ndarray) -> np.ndarray:
    """Return points of a volume, shape (..., 3), in the coordinates of another's cells."""
    (a, b), scale = (v.grid.bounds.mean(axis=1) for v in (whole, other)), _factor(whole, other)
    world = scale * (a + (points - a) @ direction_of(whole).T)
    return np.asarray(b + (world - b) @ direction_of(other))


def _inside(points: np.ndarray, volume: Volume) -> np.ndarray:
    low, high = volume.grid.bounds.T
    return np.asarray(np.all((points >= low) & (points <= high), axis=-1))


def _sample(volume: Volume) -> np.ndarray:
    axes = [np.linspace(low, high, _FEW) for low, high in volume.grid.bounds]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def _check_overlap(whole: Volume, other: Volume, first: Path, file: Path) -> str:
    """Return in words how a volume comes onto the grid of the first."""
    if not all(isinstance(volume.grid, CartesianGrid) for volume in (whole, other)):
        raise InputError(
            f"{file} has another grid than {first}, and only Cartesian grids are resampled here; "
            "bring one onto the other's with volume.resample(grid)"
        )
    pairs = ((whole, other), (other, whole))
    if not any(_inside(_places(a, b, _sample(a)), b).any() for a, b in pairs):
        raise InputError(
            f"{file} and {first} do not overlap: {_sides(other)}, but {_sides(whole)}; they are of "
            "different places, or one of them has lost its origin"
        )
    shapes = [" × ".join(map(str, volume.grid.shape)) for volume in (other, whole)]
    return (
        f"{file.name}: {shapes[0]} cells resampled onto the {shapes[1]} of {first.name}, labels to "
        "the nearest, other fields linearly"
    )


def _sides(volume: Volume) -> str:
    pairs = zip("xyz", volume.grid.bounds, strict=True)
    text = ", ".join(f"{axis} from {low:.4g} to {high:.4g}" for axis, (low, high) in pairs)
    return f"{text} {unit_name(volume.unit)}".rstrip()


def _resampled(whole: Volume, other: Volume, name: str, nearest: bool, dtype: Any) -> np.ndarray:
    """Return a field on another grid; outside of that 0 if `nearest`, else NaN."""
    from scipy.ndimage import map_coordinates

    values, middles = other.array(name), [0.5 * (e[1:] + e[:-1]) for e in whole.grid.edges]
    centers = [0.5 * (e[1:] + e[:-1]) for e in other.grid.edges]
    result = np.empty(whole.grid.shape, dtype)
    for k, x in enumerate(middles[0]):
        points = np.stack(np.meshgrid(x, *middles[1:], indexing="ij"), axis=-1)[0]
        there = _places(whole, other, points)
        cells = [
            np.interp(there[..., a], centers[a], np.arange(len(c))) for a, c in enumerate(centers)
        ]
        if nearest:
            found = values[tuple(np.rint(cell).astype(np.intp) for cell in cells)]
        else:
            found = map_coordinates(values, cells, np.float64, order=1, mode="nearest")
        result[k] = np.where(_inside(there, other), found, 0 if nearest else np.nan)
    return result


def _chosen(volume: Volume, fields: Any) -> Volume:
    """Return the volume with some of its fields."""
    asked = volume.fields if fields is None else [fields] if isinstance(fields, str) else [*fields]
    for name in asked:
        volume.field_unit(name)  # which refuses names that there are not
    for name in set(volume.fields) - set(asked):
        del volume[name]
    return volume
