"""Reader and writer of volumes in pieces: Zarr 3, for fields larger than memory.

The root's attributes say what the store is, and hold the metadata. ``/grid`` has the edges of the
cells, ``/fields/NAME`` the values in ``units``, ``/levels/1/NAME`` … their means over 2, 4 …
cells along each axis, ``/stats/NAME`` the least and the largest value of each chunk.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...fields import held_dtype
from ...grids.structured import is_structured
from ...packages import require, version
from ...progress import reporter
from ...store import FieldStore, Store, weighted_means
from ..boxes import boxes
from ..contract import Contents, ContentsReader, StoredField
from ..zarr.store import arrays_in, checked, opened, part, root_fits
from .grids import PlainGrid, exact_name, grid_of, plain_grid
from .reader import (
    GRID,
    META,
    SKY,
    TABLES,
    VERSION,
    NativeContents,
    header_text,
    json_value,
    known_meta,
    wcs_of,
)

if TYPE_CHECKING:
    import zarr

    from ...deferred import Pieces
    from ...volume import Volume

MARK = "voluminous volume"
ABOUT = (
    "A volume: /grid has the edges of the cells, /fields/NAME one value per cell in 'units', index "
    "[ix, iy, iz] (of a refined grid, flat in the 'order' of the grid); /levels/K/NAME means over "
    "2^K cells along each axis (fewer at the upper ends); /stats/NAME the least and largest value "
    "per chunk. Read it with voluminous.open(path)."
)
# Stored bits of the fraction of a number.
_FRACTION = {4: 23, 8: 52}
_HALVES = (2, 2, 2)
# All chunks are written, so that one that is lost is known to be.
_EVERY_CHUNK: Any = {"write_empty_chunks": True}


class NativeZarrReader(ContentsReader):
    """Zarr with the package's mark: any grid, fields in chunks, and metadata."""

    name = "voluminous-zarr"
    description = "a volume saved by voluminous (Zarr)"
    suffixes = (".zarr",)
    writes = writes_directory = True
    write_options = {  # noqa: RUF012 - as in Reader
        "levels": "True to add coarser levels: means over 2 x 2 x 2 cells, and so on (of grids "
        "that are not refined)",
        "stats": "True to add the least and the largest value of each chunk",
        "keep_bits": "bits of the fraction to keep of real numbers: 10 change them by up to 5e-4",
        "chunks": "cells along the sides of a chunk: a number, or three; by default 128; of a "
        "refined grid, cells of a chunk: by default 262144",
    }
    packages = ("zarr",)
    extra = "arrays"
    remote = True

    def matches(self, path: Path, head: bytes) -> bool:
        return bool(root_fits(path, head, lambda root: bool(root.attrs.get("format") == MARK)))

    def contents(self, path: Path, **options: Any) -> Contents:
        with opened(path) as root:
            attributes = dict(root.attrs)
            if (version := attributes.get("version")) != VERSION:
                raise FileFormatError(
                    f"it is a volume in version {version} of the native format, expected "
                    f"{VERSION}; a newer voluminous may read it"
                )
            plain = attributes.get(GRID)
            names, levels = attributes.get("fields"), attributes.get("levels")
            if not isinstance(plain, dict) or not isinstance(names, list):
                raise FileFormatError("its attributes must name 'grid' and 'fields'")
            grid = grid_of(PlainGrid(str(plain.get("type")), "", _values(path, root, GRID), plain))
            most = 1 + max(grid.shape).bit_length()  # the last one is a single cell
            if not isinstance(levels, int) or not 1 <= levels <= most:
                raise FileFormatError(
                    f"its attribute 'levels' must be a number from 1 to {most}, got {levels!r}"
                )
            shapes = _shapes(grid.shape, levels)
            fields = []
            for name in names:
                arrays = [_array(root, place, shapes[k]) for k, place in _places(name, levels)]
                unit, dtype = str(arrays[0].attrs.get("units", "")), np.dtype(arrays[0].dtype)
                pieces = _pieces(path, root, name, arrays)
                load = functools.partial(_part, path, name, (slice(None),) * len(grid.shape), 0)
                fields.append(StoredField(name, name, grid.shape, dtype, unit, load, pieces))
            tables = _tables(path, root) if SKY in attributes else {}
            sky = wcs_of(str(attributes[SKY]), tables) if SKY in attributes else None
            meta = known_meta(str(attributes.get(META, "{}")))
            return NativeContents(fields, lambda _: grid, meta, sky)

    def finish(self, volume: Volume, contents: Contents) -> None:
        assert isinstance(contents, NativeContents)
        volume.wcs = contents.wcs

    def write(
        self,
        volume: Volume,
        path: Path,
        *,
        levels: bool = False,
        stats: bool = False,
        keep_bits: int | None = None,
        chunks: Any = None,
    ) -> None:

        library = require("zarr", self.extra, "writing Zarr")
        grid = volume.grid
        if levels and not is_structured(grid):
            raise InputError(
                "coarser levels are means over 2 x 2 x 2 cells, and these are refined: leave out "
                "levels, or make a Cartesian grid: volume.resample(vm.CartesianGrid.uniform(…)), "
                "convert --resample 512x512x512"
            )
        sides = _sides(chunks, len(grid.shape), bool(levels))
        if keep_bits is not None and (type(keep_bits) is not int or not 1 <= keep_bits <= 52):
            raise InputError(f"keep_bits must be a number from 1 to 52, got {keep_bits!r}")
        root = library.open_group(str(path), mode="w-", zarr_format=3)
        plain = plain_grid(grid)
        for name, values in plain.arrays.items():
            root.create_array(f"{GRID}/{name}", data=np.asarray(values), config=_EVERY_CHUNK)
        shapes = _shapes(grid.shape, _level_count(grid.shape, sides) if levels else 1)
        report, done = reporter(), itertools.count(1)
        total = len(volume.fields) * math.prod(_counts(grid.shape, sides))
        for name in volume.fields:
            # A copy does not keep values that were read: one field at a time is in memory.
            store = volume.with_arrays({}).store.without_ranges()
            dtype = held_dtype(volume.describe()["fields"][name]["dtype"])
            arrays = [
                _new_array(root, place, shapes[k], sides, dtype)
                for k, place in _places(name, len(shapes))
            ]
            arrays[0].attrs["units"] = exact_name(volume.field_unit(name))
            pyramid = Pyramid(store, name, arrays, sides, keep_bits)
            for _ in pyramid.write():
                report(next(done), total)
            if stats:
                ends = pyramid.extremes
                _new_array(root, f"stats/{name}", ends.shape, ends.shape, dtype)[...] = ends
        attributes: dict[str, Any] = {"written_by": f"voluminous {version()}", "about": ABOUT}
        attributes |= {GRID: {"type": plain.type, "order": plain.order, **plain.attributes}}
        attributes |= {"fields": list(volume.fields)}
        attributes |= {"levels": len(shapes)}
        if volume.meta:
            attributes[META] = json.dumps(volume.meta, default=json_value, ensure_ascii=False)
        if volume.wcs is not None:
            text, tables = header_text(volume.wcs)
            attributes[SKY] = text
            for (table, column), values in tables.items():
                place = f"{TABLES}/{table}/{column}"
                root.create_array(place, data=np.asarray(values), config=_EVERY_CHUNK)
        # Last of all: without them the store is no volume.
        root.attrs.update({"format": MARK, "version": VERSION, **attributes})
        with warnings.catch_warnings():
            # The specification of Zarr 3 does not have it; readers of servers need it.
            warnings.simplefilter("ignore")
            library.consolidate_metadata(str(path))


@dataclass
class Pyramid:
    """A field that is written chunk by chunk, with the levels above a chunk once it is complete."""

    store: Store
    name: str
    # Of the levels, finest first.
    arrays: Sequence[zarr.Array[Any]]
    sides: tuple[int, ...]
    keep_bits: int | None = None

    def __post_init__(self) -> None:
        counts = _counts(self.arrays[0].shape, self.sides)
        self.extremes = np.empty((*counts, 2), self.arrays[0].dtype)

    def write(self) -> Iterator[None]:
        """Write all levels; yields after each chunk of the finest."""
        for index in np.ndindex(*_counts(self.arrays[-1].shape, self.sides)):
            yield from self._write(len(self.arrays) - 1, index, [])

    def _write(
        self, level: int, index: tuple[int, ...], above: Sequence[np.ndarray]
    ) -> Iterator[None]:
        """Write a chunk after those it covers; put means of it into a part of the one above.

        Beside the means of a chunk is how many of the finest cells count in them.
        """
        array = self.arrays[level]
        low = [i * side for i, side in zip(index, self.sides, strict=True)]
        high = [min(a + s, n) for a, s, n in zip(low, self.sides, array.shape, strict=True)]
        if level == 0:
            values = rounded(self.store.read(self.name, low, high), self.keep_bits)
            self.extremes[index] = values.min(), values.max()
            weights = None
            yield
        else:
            shape = [b - a for a, b in zip(low, high, strict=True)]
            weights = np.empty(shape)
            values = np.empty(shape, array.dtype)
            below = _counts(self.arrays[level - 1].shape, self.sides)
            for child in np.ndindex(2, 2, 2):
                number = tuple(2 * i + c for i, c in zip(index, child, strict=True))
                if all(n < count for n, count in zip(number, below, strict=True)):
                    first = [c * side // 2 for c, side in zip(child, self.sides, strict=True)]
                    ends = [f + side // 2 for f, side in zip(first, self.sides, strict=True)]
                    # An axis of a single chunk may have an odd number of cells.
                    ends = [e if k > 1 else None for e, k in zip(ends, below, strict=True)]
                    target = tuple(map(slice, first, ends))
                    yield from self._write(level - 1, number, [values[target], weights[target]])
            values = rounded(values, self.keep_bits)
        array[tuple(map(slice, low, high))] = values
        if above:
            above[0][...], above[1][...] = weighted_means(values, _HALVES, weights)


def rounded(values: np.ndarray, keep_bits: int | None) -> np.ndarray:
    """Return real numbers rounded to so many bits of their fraction, ties to even.

    Relative errors are at most ``2**-(keep_bits + 1)``. Infinities and NaN stay, as do the few
    numbers that would become infinite.
    """
    fraction = _FRACTION.get(values.dtype.itemsize, 0)
    if keep_bits is None or values.dtype.kind != "f" or keep_bits >= fraction:
        return values
    unsigned = np.dtype(f"u{values.dtype.itemsize}").type
    bits, drop = values.view(unsigned), fraction - keep_bits
    odd = (bits >> unsigned(drop)) & unsigned(1)
    result = bits + odd
    result += unsigned((1 << (drop - 1)) - 1)
    result &= ~unsigned((1 << drop) - 1)
    numbers = result.view(values.dtype)
    return np.asarray(np.where(np.isfinite(numbers) & np.isfinite(values), numbers, values))


def _sides(chunks: Any, axes: int, even: bool) -> tuple[int, ...]:
    given: Any = (FieldStore.side if axes == 3 else FieldStore.leaves) if chunks is None else chunks
    sides = (given,) * axes if np.ndim(given) == 0 else given
    if len(sides) != axes or not all(isinstance(n, (int, np.integer)) and n > 0 for n in sides):
        more = ", or three" if axes == 3 else ""
        raise InputError(f"chunks must be a number of cells{more}, got {chunks!r}")
    if even and any(n % 2 for n in sides):
        raise InputError(f"chunks must be even where there are levels, got {chunks!r}")
    return tuple(int(n) for n in sides)


def _counts(shape: Sequence[int], sides: Sequence[int]) -> tuple[int, ...]:
    return tuple(-(-n // side) for n, side in zip(shape, sides, strict=True))


def _level_count(shape: Sequence[int], sides: Sequence[int]) -> int:
    return 1 + max((count - 1).bit_length() for count in _counts(shape, sides))


def _shapes(shape: Sequence[int], levels: int) -> list[tuple[int, ...]]:
    return [tuple(-(-n >> level) for n in shape) for level in range(levels)]


def _places(name: str, levels: int) -> list[tuple[int, str]]:
    return [(k, f"levels/{k}/{name}" if k else f"fields/{name}") for k in range(levels)]


def _new_array(
    root: Any, place: str, shape: tuple[int, ...], sides: tuple[int, ...], dtype: np.dtype[Any]
) -> zarr.Array[Any]:
    from zarr.codecs import BloscCodec, Crc32cCodec

    packed = BloscCodec(cname="zstd", clevel=5, shuffle="bitshuffle")
    made: zarr.Array[Any] = root.create_array(
        place,
        shape=shape,
        dtype=dtype,
        chunks=tuple(min(n, side) for n, side in zip(shape, sides, strict=True)),
        # Blosc may take a chunk that is cut short for a sound one.
        compressors=[packed, Crc32cCodec()],
        fill_value=np.nan if dtype.kind == "f" else None,
        config=_EVERY_CHUNK,
        dimension_names=None,
    )
    return made


def _values(path: Path, root: Any, place: str) -> dict[str, np.ndarray]:
    if place not in root:
        raise FileFormatError(f"expected a group /{place}")
    return {
        key.removeprefix(f"{place}/"): part(path, key, complete=True)
        for key in arrays_in(root, place)
    }


def _tables(path: Path, root: Any) -> dict[tuple[str, str], np.ndarray]:
    values = _values(path, root, TABLES) if TABLES in root else {}
    keys = [key.split("/") for key in values]
    return {(k[0], k[1]): v for k, v in zip(keys, values.values(), strict=True) if len(k) == 2}


def _array(root: Any, place: str, shape: tuple[int, ...]) -> zarr.Array[Any]:
    if place not in root or not hasattr(root[place], "shape"):
        raise FileFormatError(f"expected an array /{place}")
    array = checked(root[place])
    if tuple(array.shape) != shape or np.dtype(array.dtype).kind not in "fiub":
        raise FileFormatError(
            f"/{place} must be numbers of shape {shape}, got {array.dtype} of {array.shape}"
        )
    return array


def _pieces(path: Path, root: Any, name: str, arrays: Sequence[zarr.Array[Any]]) -> Pieces:
    shapes = [tuple(array.shape) for array in arrays]
    load, axes = functools.partial(_part, path, name), range(len(shapes[0]))
    pieces = boxes(load, shapes, tuple(arrays[0].chunks), axes, [False for _ in axes])
    if (place := f"stats/{name}") not in root:
        return pieces
    counts = _counts(shapes[0], arrays[0].chunks)
    _array(root, place, (*counts, 2))
    return replace(pieces, extremes=functools.partial(part, path, place, complete=True))


def _part(path: Path, name: str, index: tuple[slice, ...], level: int) -> np.ndarray:
    return part(path, _places(name, level + 1)[level][1], index, complete=True)
