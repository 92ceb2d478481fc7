"""What files beside a raw one tell of it: Open SciVis, vtk.js and InVesalius."""

from __future__ import annotations

import json
import plistlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

import numpy as np

from ...errors import FileFormatError, InputError
from .told import Told, given_dtype, given_shape

# Longer descriptions are something else.
_LONGEST = 4 << 20
# What describes a raw file for other readers: open these instead.
_HEADERS = (".mhd", ".nhdr", ".hdr")


def told_beside(path: Path, stems: tuple[str, ...]) -> Told:
    """Return what a description beside a file tells; nothing if there is none.

    Parameters
    ----------
    path : Path
        The raw file.
    stems : tuple of str
        Names, without ending, that its description may have.

    Raises
    ------
    FileFormatError
        If there is a description that cannot be used.
    """
    for beside, parse in _descriptions(path, stems):
        if beside.stat().st_size > _LONGEST:
            continue
        try:
            told = parse(beside.read_bytes())
        except (
            KeyError,
            IndexError,
            TypeError,
            ValueError,
            AttributeError,
            RecursionError,
            OverflowError,
            ExpatError,
            plistlib.InvalidFileException,
            InputError,
        ) as error:
            raise FileFormatError(
                f"{beside.name} beside it is not as expected ({type(error).__name__}: {error}); "
                "give shape=(nx, ny, nz) and dtype=… yourself"
            ) from error
        if told is not None:
            return Told(**{**vars(told), "source": beside.name})
    return Told()


def described_by(path: Path) -> bool:
    """Return True for a file that describes a raw one, as far as can be told."""
    parse = _PARSERS.get(path.suffix.lower())
    try:
        if parse is None or path.stat().st_size > _LONGEST:
            return False
        return parse(path.read_bytes()) is not None
    except Exception:  # what is damaged, or something else of that name
        return False


def is_description_of(described: Path, stems: tuple[str, ...]) -> bool:
    """Return True if the name of a description goes with one of these."""
    return any(described.name == stem + ending for stem in stems for ending in _ENDINGS)


def header_beside(path: Path, stems: tuple[str, ...]) -> str:
    """Return the name of a header of another format beside a file, empty if there is none."""
    names = [stem + ending for stem in stems for ending in _HEADERS]
    return next((name for name in names if path.with_name(name).is_file()), "")


def _descriptions(
    path: Path, stems: tuple[str, ...]
) -> Iterator[tuple[Path, Callable[[bytes], Told | None]]]:
    for stem in stems:
        for ending in _ENDINGS:
            beside = path.with_name(stem + ending)
            if beside.is_file():
                yield beside, _PARSERS[beside.suffix]


def _json(text: bytes) -> Told | None:
    found = json.loads(text)
    if not isinstance(found, Mapping):
        return None
    if "vtkClass" in found:
        return _vtkjs(found)
    return _scivis(found) if "size" in found and "type" in found else None


def _scivis(found: Mapping[str, Any]) -> Told:
    return Told(
        given_shape(found["size"]),
        _little(found["type"]),
        _three(found["spacing"]) if "spacing" in found else None,
    )


def _vtkjs(found: Mapping[str, Any]) -> Told:
    extent = [int(n) for n in found["extent"]]
    spacing = _three(found.get("spacing", (1, 1, 1)))
    origin = np.array(_three(found.get("origin", (0, 0, 0))))
    direction = _direction(found.get("direction"))
    steps = spacing * np.array(np.eye(3) if direction is None else direction)
    data = found["pointData"]["arrays"][0]["data"]
    kind = str(data["dataType"]).removesuffix("Array").lower().replace("clamped", "")
    big = data.get("ref", {}).get("encode") == "BigEndian"
    return Told(
        given_shape([extent[k + 1] - extent[k] + 1 for k in (0, 2, 4)]),
        given_dtype(kind).newbyteorder(">" if big else "<"),
        spacing,
        _three(origin + steps @ extent[::2]),
        direction,
    )


def _direction(given: Any) -> tuple[tuple[float, ...], ...] | None:
    """Return a matrix, None for the axes x, y and z themselves; vtk.js lists it by columns."""
    if given is None or np.allclose(given, np.eye(3).reshape(-1)):
        return None
    matrix = np.array([float(n) for n in given]).reshape(3, 3).T
    return tuple(map(tuple, matrix.tolist()))


def _plist(text: bytes) -> Told | None:
    """Return what a project of InVesalius tells: its matrix lists z first, lengths are in mm."""
    found = plistlib.loads(text)
    if "matrix" not in found:
        return None
    matrix = found["matrix"]
    return Told(
        given_shape(matrix["shape"][::-1]),
        _little(matrix["dtype"]),
        _three(found["spacing"]),
        unit="mm",
    )


def _little(name: Any) -> np.dtype[Any]:
    return given_dtype(name).newbyteorder("<")


def _three(values: Any) -> Any:
    numbers = tuple(float(v) for v in values)
    if len(numbers) != 3 or not np.all(np.isfinite(numbers)):
        raise ValueError(f"expected three numbers, got {values!r}")
    return numbers


# Endings of descriptions, and what reads them.
_ENDINGS = (".json", ".index.json", ".plist")
_PARSERS: dict[str, Callable[[bytes], Told | None]] = {".json": _json, ".plist": _plist}
