"""Pictures in TIFF files, read by tifffile once it is known that they are there."""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...packages import require
from ..arrays.layout import equal_cells
from ..payload import mapped
from .placement import Placement

STACK_OPTIONS = {
    "spacing": "width of the voxels, or one per axis x, y, z; by default what the file tells",
    "unit": "unit of length",
}
# Packings that need nothing else: none, Deflate, PackBits.
_UNPACKED_HERE = (1, 8, 32946, 32773)
# Deflate, the best packer among them, makes data at most 1032 times smaller.
_MOST_PACKED = 1032


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a file; of a set of files this one only, and without a word about odd tags."""
    import tifffile

    logger = logging.getLogger("tifffile")
    before, logger.disabled = logger.disabled, True
    try:
        with tifffile.TiffFile(path, _multifile=False) as file:
            yield file
    finally:
        logger.disabled = before


def cells_from_zero(shape: tuple[int, ...], spacing: Any, unit: Any) -> Placement:
    """Return the placement of cells that begin at 0, as in other files of arrays."""
    grid = equal_cells(shape, {"spacing": spacing}, unit)
    widths = np.ptp(grid.bounds, axis=1) / grid.shape
    return Placement(widths / 2, np.diag(widths), grid.describe()["unit"])


def single_picture(path: Path) -> np.ndarray:
    """Return the first picture of a file, shape (rows, columns) or (rows, columns, samples).

    Raises
    ------
    FileFormatError
        If it has other axes.
    """
    with opened(path) as file:
        page = file.pages.first
        _check_pages(path, [page])
        if page.axes not in ("YX", "YXS"):
            raise FileFormatError(f"expected a picture with rows and columns, got {page.axes}")
        return page.asarray()


def part_of(path: Path, file: Any, number: int, index: tuple[Any, ...]) -> np.ndarray:
    """Return part of a series; only the pictures needed are read."""
    series = file.series[number]
    if series.dataoffset is not None:
        dtype = np.dtype(series.dtype).newbyteorder(file.byteorder)
        return mapped(path, series.dataoffset, series.shape, dtype)[index]
    outer = _outer_axes(series)
    numbers = np.arange(len(series.pages)).reshape(series.shape[:outer])[index[:outer]]
    pages = [series.pages[k] for k in np.ravel(numbers)]
    _check_pages(path, pages)
    values = file.asarray(key=[int(k) for k in np.ravel(numbers)], series=number)
    values = values.reshape(*np.shape(numbers), *series.shape[outer:])
    return values[(slice(None),) * np.ndim(numbers) + index[outer:]]


def _outer_axes(series: Any) -> int:
    for outer in range(len(series.shape)):
        if math.prod(series.shape[:outer]) == len(series.pages):
            return outer
    raise FileFormatError(
        f"expected pictures for the shape {series.shape}, found {len(series.pages)}"
    )


def _check_pages(path: Path, pages: list[Any]) -> None:
    if any(page is None for page in pages):
        raise FileFormatError("some of its pictures are missing: they are in other files")
    first, found = pages[0].keyframe, path.stat().st_size
    if first.compression not in _UNPACKED_HERE or first.predictor == 3:
        require("imagecodecs", "tiff", f"unpacking TIFF ({first.compression.name})")
    needed = math.prod(first.chunked)
    for number, page in enumerate(pages):
        ends = [a + n for a, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
        if len(ends) < needed or max(ends) > found:
            raise FileFormatError(
                f"{path.name} is cut short: {found} bytes, but picture {number + 1} ends at byte "
                f"{max(ends, default=0)} with {len(ends)} of {needed} strips or tiles"
            )
    size = max(math.prod(first.shape), math.prod(first.chunks) * needed) * first.dtype.itemsize
    if size > max(_MOST_PACKED * found, 1 << 24):
        raise FileFormatError(f"{found} bytes cannot hold pictures of {size} bytes each")
