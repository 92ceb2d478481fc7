"""Raw volumes: x varies fastest, unless told otherwise."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...deferred import Deferred
from ...errors import InputError
from ..arrays.layout import equal_cells
from ..contract import FieldInfo, Reader
from ..names import chosen_fields
from .content import Content, content_of, split
from .told import told_by_name

if TYPE_CHECKING:
    from ...grids import CartesianGrid
    from ...volume import Volume

# Endings of bare numbers, if the name tells shape and type.
_SUFFIXES = (".raw", ".bin", ".vol", ".dat", ".img")


class RawReader(Reader):
    """Bare numbers, packed or not; shape and type are in the name, beside the file, or given."""

    name = "raw"
    description = "a raw file of numbers"
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
        """Return True for files called ``.raw``, and those whose names tell shape and type.

        Nothing in such a file tells what it is: all others are asked before.
        """
        suffix, stem = split(path)
        told, _ = told_by_name(stem)
        named = told.shape is not None and told.dtype is not None
        return bool(head) and (suffix == ".raw" or (suffix in _SUFFIXES and named))

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        """Return the volume; the values stay in the file until they are used."""
        from ...volume import Volume

        content = content_of(path, options)
        volume = Volume(_grid(content, options))
        for name in chosen_fields({content.place: options.get("name") or content.place}, fields):
            volume[name] = Deferred(content.values, content.dtype, mapped=content.mapped)
        volume.meta["shape_from"] = content.told.source
        if content.told.direction is not None:
            volume.meta["direction"] = list(content.told.direction)
            warnings.warn(
                f"{path.name}: the cells are turned against x, y and z by the matrix in "
                "meta['direction']; x, y and z are taken along the cells",
                stacklevel=2,
            )
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        """Return the one field."""
        content = content_of(path, options)
        name = options.get("name") or content.place
        return (FieldInfo(name, content.place, content.shape, str(content.dtype)),)


def _grid(content: Content, options: Mapping[str, Any]) -> CartesianGrid:
    """Return the grid that the user gives, or that is told beside the file; else unit cells."""
    told, unit = content.told, options.get("unit") or content.told.unit
    if options.get("bounds") is not None or options.get("spacing") is not None:
        if options.get("bounds") is not None and options.get("spacing") is not None:
            raise InputError("give bounds or spacing, not both")
        return equal_cells(content.cells, options, unit)
    spacing = told.spacing or (1.0, 1.0, 1.0)
    # What tells an origin means the centre of the first cell.
    origin = told.origin or tuple(0.5 * d for d in spacing)
    lows = [o - 0.5 * d for o, d in zip(origin, spacing, strict=True)]
    bounds = [(a, a + n * d) for a, n, d in zip(lows, content.cells, spacing, strict=True)]
    return equal_cells(content.cells, {"bounds": bounds}, unit)
