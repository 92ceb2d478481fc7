"""Writes volumes as image data (.vti) or rectilinear grids (.vtr): cell data, appended as bytes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from ...errors import InputError
from ..cartesian import cartesian
from ..scanners.voxels import VECTOR
from ..scanners.written import direction_of

if TYPE_CHECKING:
    from ...grids import CartesianGrid
    from ...volume import Volume

_HEAD = np.dtype("<u8")
_UPRIGHT = np.eye(3)


@dataclass(frozen=True)
class Column:
    """An array to write: one field, or the three of a vector."""

    name: str
    fields: tuple[str, ...]
    dtype: np.dtype[Any]
    unit: str


def write_image(volume: Volume, path: Path) -> None:
    """Write a volume of equal cells.

    Raises
    ------
    InputError
        If its cells are not equal.
    """
    grid = cartesian(volume)
    if not grid.is_uniform:
        raise InputError("image data have equal cells, these are not: write a .vtr file")
    low, high = grid.bounds.T
    spacing = (high - low) / grid.shape
    direction = direction_of(volume)
    middle = (low + high) / 2
    attributes = {
        # The grid of an oblique volume lies about the volume's true centre.
        "Origin": low
        if np.array_equal(direction, _UPRIGHT)
        else middle + direction @ (low - middle),
        "Spacing": spacing,
        "Direction": direction.ravel(),
    }
    _write(volume, grid, path, "ImageData", attributes, "")


def write_rectilinear(volume: Volume, path: Path) -> None:
    """Write a volume of any cells between planes."""
    grid = cartesian(volume)
    if not np.array_equal(direction_of(volume), _UPRIGHT):
        warnings.warn(
            "rectilinear grids of VTK cannot be turned: what meta['direction'] says of the cells "
            "is lost. A .vti file keeps it",
            stacklevel=2,
        )
    lines = "".join(
        f'<DataArray type="Float64" Name="{axis}" format="ascii">{_listed(edges)}</DataArray>\n'
        for axis, edges in zip("xyz", grid.edges, strict=True)
    )
    _write(volume, grid, path, "RectilinearGrid", {}, f"<Coordinates>\n{lines}</Coordinates>\n")


def _write(
    volume: Volume,
    grid: CartesianGrid,
    path: Path,
    kind: str,
    attributes: dict[str, Any],
    coordinates: str,
) -> None:
    columns = list(_columns(volume))
    extent = " ".join(f"0 {n}" for n in grid.shape)
    told = "".join(f' {name}="{_listed(values)}"' for name, values in attributes.items())
    with open(path, "wb") as file:
        head = (
            '<?xml version="1.0"?>\n'
            f'<VTKFile type="{kind}" version="1.0" byte_order="LittleEndian"'
            ' header_type="UInt64">\n'
            f'<{kind} WholeExtent="{extent}"{told}>\n{_remarks(volume)}'
            f'<Piece Extent="{extent}">\n<CellData{_active(columns)}>\n{_arrays(columns, grid)}'
            f"</CellData>\n{coordinates}</Piece>\n</{kind}>\n"
            '<AppendedData encoding="raw">\n_'
        )
        file.write(head.encode())
        for column in columns:
            _write_values(volume, column, file)
        file.write(b"\n</AppendedData>\n</VTKFile>\n")


def _columns(volume: Volume) -> Iterator[Column]:
    """Give what is written: components of vectors that fit together become one array."""
    units, done = volume.units, set()
    types = {name: np.dtype(told["dtype"]) for name, told in volume.describe()["fields"].items()}
    for name in volume.fields:
        base = name.removesuffix(VECTOR[0])
        parts = tuple(base + ending for ending in VECTOR)
        alike = {(types.get(part), units.get(part)) for part in parts} == {
            (types[name], units[name])
        }
        if name != base and alike and base not in types:
            done |= set(parts)
            yield Column(base, parts, types[name], units[name])
    for name in volume.fields:
        if name not in done:
            yield Column(name, (name,), types[name], units[name])


def _arrays(columns: list[Column], grid: CartesianGrid) -> str:
    """Return the elements that tell of the arrays."""
    told, offset = "", 0
    for column in columns:
        kind = _stored(column.dtype)
        name = {"f": "Float", "i": "Int", "u": "UInt"}[kind.kind] + str(8 * kind.itemsize)
        told += (
            f'<DataArray type="{name}" Name="{column.name}" NumberOfComponents='
            f'"{len(column.fields)}" format="appended" offset="{offset}">'
        )
        if column.unit:
            told += (
                '<InformationKey name="UNITS_LABEL" location="vtkDataArray">'
                f"{escape(column.unit)}</InformationKey>"
            )
        told += "</DataArray>\n"
        offset += _HEAD.itemsize + _size(column, grid.size)
    return told


def _write_values(volume: Volume, column: Column, file: IO[bytes]) -> None:
    """Write the values, x fastest, layer by layer: a whole copy would take the memory again."""
    parts = [volume.array(name) for name in column.fields]
    file.write(np.array(_size(column, parts[0].size), _HEAD).tobytes())
    kind = _stored(column.dtype)
    for k in range(parts[0].shape[2]):
        layer = np.stack([part[:, :, k].T for part in parts], axis=-1)
        file.write(layer.astype(kind, copy=False).tobytes())


def _size(column: Column, cells: int) -> int:
    return cells * len(column.fields) * _stored(column.dtype).itemsize


def _stored(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return the type of values in the file: there are no truth values in VTK."""
    return np.dtype("u1") if dtype.kind == "b" else dtype.newbyteorder("<")


def _active(columns: list[Column]) -> str:
    scalars = [column.name for column in columns if len(column.fields) == 1]
    return f" Scalars={quoteattr(scalars[0])}" if scalars else ""


def _remarks(volume: Volume) -> str:
    """Return the elements of numbers and texts that the volume tells besides."""
    meta = {("TimeValue" if name == "time" else name): v for name, v in volume.meta.items()}
    if volume.unit is not None:
        meta["length_unit"] = str(volume.unit)
    told = "".join(_remark(name, value) for name, value in meta.items() if name != "direction")
    return f"<FieldData>\n{told}</FieldData>\n" if told else ""


def _remark(name: str, value: Any) -> str:
    """Return the element of one number or text; nothing for anything else."""
    text = isinstance(value, str)
    if text:
        numbers, kind, element = " ".join(map(str, value.encode() + b"\0")), "String", "Array"
    elif isinstance(value, Real) and not isinstance(value, bool):
        numbers, kind, element = _listed([value]), "Float64", "DataArray"
    else:
        return ""
    return (
        f'<{element} type="{kind}" Name={quoteattr(name)} NumberOfTuples="1" format="ascii">'
        f"{numbers}</{element}>\n"
    )


def _listed(values: Any) -> str:
    """Return numbers with all their digits."""
    return " ".join(repr(float(value)) for value in values)
