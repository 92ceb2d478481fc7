"""A directory of numbered pictures, each a slice: what micro-CT and light-sheet software writes."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ..channels import Y_DOWN, of_samples
from ..guard import reading
from .tiff_chain import check_chain
from .tiff_pages import STACK_OPTIONS, cells_from_zero, single_picture
from .voxels import COLORS, VoxelReader, Voxels, components

_TIFF = (".tif", ".tiff")
_SUFFIXES = (*_TIFF, ".png")
# What lies beside slices, and says how they were made.
_NOTES = ("", ".txt", ".log", ".xml", ".json", ".csv", ".ini", ".md", ".db", ".info")
_NUMBER = re.compile(r"(\d+)")
_PNG_END = b"IEND\xaeB`\x82"
# Kinds of pixels whose numbers are values, as Pillow calls them.
_MODES = ("1", "L", "LA", "I", "I;16", "I;16B", "F", "RGB", "RGBA")
_BRIGHTNESS = ("_0", "_alpha")


class PicturesReader(VoxelReader):
    """Pictures of one size and kind, sorted by the numbers in their names."""

    name = "pictures"
    description = "a directory of numbered pictures (.tif, .png), one per slice"
    options = {**VoxelReader.options, **STACK_OPTIONS}  # noqa: RUF012 - as in Reader

    def matches(self, path: Path, head: bytes) -> bool:
        try:
            return path.is_dir() and len(_slices(path)) > 1
        except OSError:
            return False

    def voxels(self, path: Path, *, spacing: Any = None, unit: Any = None) -> Voxels:
        slices = _slices(path)
        if len(slices) < 2:
            raise FileFormatError(
                f"expected a directory of numbered pictures ({', '.join(_SUFFIXES)}) of one kind, "
                "with nothing else in it but notes"
            )
        first = _picture(slices[0])
        rows, columns, samples = first.shape
        shape = (columns, rows, len(slices))

        def load(sample: int) -> np.ndarray:
            out = np.empty((len(slices), rows, columns), first.dtype)
            for number, file in enumerate(slices):
                picture = _picture(file)
                if (picture.shape, picture.dtype) != (first.shape, first.dtype):
                    raise FileFormatError(
                        f"{file.name} is a picture of {picture.shape} {picture.dtype}, but "
                        f"{slices[0].name} is one of {first.shape} {first.dtype}"
                    )
                out[number] = picture[..., sample]
            return out.transpose()

        return Voxels(
            shape=shape,
            dtype=first.dtype.newbyteorder("="),
            placement=cells_from_zero(shape, 1.0 if spacing is None else spacing, unit),
            load=load,
            components=("",)
            if samples == 1
            else components(samples, COLORS if samples > 2 else _BRIGHTNESS),
            name=path.resolve().name,
            channels=of_samples(samples),
            meta=Y_DOWN,
        )


def _slices(directory: Path) -> list[Path]:
    """Return the pictures of a directory, in the order of their numbers; none if it is another."""
    with os.scandir(directory) as entries:
        names = [e.name for e in entries if not e.name.startswith(".") and e.is_file()]
    found = [n for n in names if n.lower().endswith(_SUFFIXES) and _NUMBER.search(Path(n).stem)]
    others = {Path(name).suffix.lower() for name in names if name not in found}
    kinds = {_NUMBER.sub("#", name) for name in found}
    if len(kinds) != 1 or not others <= set(_NOTES):
        return []
    return [directory / name for name in sorted(found, key=_numbers)]


def _numbers(name: str) -> list[int]:
    return [int(number) for number in _NUMBER.findall(name)]


def _picture(path: Path) -> np.ndarray:
    with reading(path, "a picture"):
        values = _tiff(path) if path.suffix.lower() in _TIFF else _png(path)
    return values if values.ndim == 3 else values[..., None]


def _tiff(path: Path) -> np.ndarray:
    check_chain(path)
    return single_picture(path)


def _png(path: Path) -> np.ndarray:
    from PIL import Image

    with open(path, "rb") as file:
        file.seek(-min(64, path.stat().st_size), os.SEEK_END)
        if _PNG_END not in file.read():
            raise FileFormatError("it is cut short: the end of a PNG file is missing")
    with Image.open(path) as picture:
        if picture.mode not in _MODES:
            raise FileFormatError(f"expected pixels that are values, got the mode {picture.mode!r}")
        return np.asarray(picture)
