"""Raw volumes: x varies fastest, unless told otherwise."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import InputError
from ..arrays.layout import equal_cells
from ..contract import FieldInfo, Reader
from ..names import chosen_fields
from ..scanners.placement import Arrangement, Placement, arranged
from .content import Content, content_of, split, stems_of
from .sidecar import described_by, is_description_of
from .told import told_by_name

if TYPE_CHECKING:
    from ...volume import Volume

# Endings of bare numbers, if the name tells shape and type.
_SUFFIXES = (".raw", ".bin", ".vol", ".dat", ".img")


class RawReader(Reader):
    """Bare numbers, packed or not; shape and type are in the name, beside the file, or given."""

    name = "raw"
    description = "a raw file of numbers, or what describes one (.json, .plist)"
    suffixes = (".raw",)
    options = {  # noqa: RUF012 - as in Reader
        "shape": "number of cells (nx, ny, nz)",
        "dtype": "type of a value: 'uint8', 'int16', 'float32', '>u2' …",
        "byteorder": "'little' (default) or 'big'",
        "offset": "bytes before the first value",
        "axes": "what the axes are, from the slowest to the fastest: 'zyx' (default), 'xyz' …",
        "bounds": "(low, high) or ((x0, x1), (y0, y1), (z0, z1))",
        "spacing": "cell width, or one per axis; by default that told beside the file, else 1",
        "unit": "unit of length",
        "name": "name of the field; by default that of the file",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        """Return True for files called ``.raw``, those whose names tell shape and type, and notes.

        Nothing in such a file tells what it is: all others are asked before. A note is what
        describes the numbers in a file beside it.
        """
        if described_by(path):
            return True
        suffix, stem = split(path)
        told, _ = told_by_name(stem)
        named = told.shape is not None and told.dtype is not None
        return bool(head) and (suffix == ".raw" or (suffix in _SUFFIXES and named))

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        from ...volume import Volume

        content = content_of(_numbers_of(path), options)
        placed = _arrangement(content, options)
        volume = Volume(placed.grid)
        load = functools.partial(_load, content, placed)
        for name in chosen_fields({content.place: options.get("name") or content.place}, fields):
            volume[name] = Deferred(load, content.dtype, mapped=content.mapped)
        volume.meta["shape_from"] = content.told.source
        if placed.direction is not None:
            volume.meta["direction"] = placed.direction.tolist()
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        content = content_of(_numbers_of(path), options)
        name = options.get("name") or content.place
        return (FieldInfo(name, content.place, content.shape, str(content.dtype)),)


def _numbers_of(path: Path) -> Path:
    """Return the raw file that a description is of; any other path as it is.

    Raises
    ------
    InputError
        If there is none beside it, or there are several.
    """
    if not described_by(path):
        return path
    files = [f for f in sorted(path.parent.iterdir()) if f.is_file() and split(f)[0] in _SUFFIXES]
    found = [f for f in files if is_description_of(path, stems_of(f))]
    if len(found) == 1:
        return found[0]
    if found:
        listed = ", ".join(f.name for f in found)
        raise InputError(f"it describes raw numbers, and several files beside it: open {listed}")
    raise InputError(
        "it describes raw numbers, but there is no file beside it with them: expected "
        f"{path.name.split('.')[0]}.raw or the like in {path.parent}. Open the file of numbers "
        "with vm.open(path, shape=…, dtype=…)"
    )


def _load(content: Content, placed: Arrangement) -> np.ndarray:
    return placed.put(content.values())


def _arrangement(content: Content, options: Mapping[str, Any]) -> Arrangement:
    """Return where the cells are: as the user says, or as is told beside; else unit cells."""
    told, unit = content.told, options.get("unit") or content.told.unit
    if options.get("bounds") is not None or options.get("spacing") is not None:
        if options.get("bounds") is not None and options.get("spacing") is not None:
            raise InputError("give bounds or spacing, not both")
        grid = equal_cells(content.cells, options, unit)
        return Arrangement(grid, (0, 1, 2), (False, False, False), None)
    spacing = np.array(told.spacing or (1.0, 1.0, 1.0))
    # What tells an origin means the centre of the first cell.
    origin = 0.5 * spacing if told.origin is None else told.origin
    steps = np.eye(3) if told.direction is None else np.array(told.direction).T
    return arranged(content.cells, Placement(origin, spacing[:, None] * steps, unit))
