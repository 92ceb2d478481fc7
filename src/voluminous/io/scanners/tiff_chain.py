"""The chain of directories in a TIFF file: how many pictures there are, without decoding any."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from ...errors import FileFormatError

MAGICS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_SUBFILE, _DESCRIPTION, _DEPTH = 254, 270, 32997
_REDUCED = 1  # a smaller copy of another picture
# Bytes of a value of each type, by the number of the type.
_TYPE_SIZES = np.array([0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8])
_FIRST_PRIVATE = 32768  # in tags of their own, makers of programs may write what they like
# A single directory can stand for a stack that follows in one piece.
_STACK = re.compile(
    rb'images=0*([2-9]|1\d)|\bSizeZ="0*([2-9]|1\d)|'
    rb'^\{("truncated": true, )?"shape": \[(\d+, ){2}\d+\]'
)
_LONGEST_TEXT = 1 << 16


@dataclass(frozen=True)
class _Layout:
    """Types and sizes of the numbers that lead through a file: TIFF, or BigTIFF."""

    order: str
    big: bool

    @property
    def offset(self) -> str:
        return f"{self.order}u{8 if self.big else 4}"

    @property
    def count(self) -> str:
        return f"{self.order}u{8 if self.big else 2}"

    @property
    def tag(self) -> np.dtype:
        short = f"{self.order}u2"
        return np.dtype(
            [("code", short), ("type", short), ("length", self.offset), ("value", self.offset)]
        )


def holds_stack(path: Path) -> bool:
    """Return True for a TIFF file of more than one picture, thumbnails left out.

    A damaged one counts: what is wrong is told when it is read.
    """
    try:
        pictures, first = _walk(path, enough=2)
        return pictures > 1 or first
    except (OSError, FileFormatError):
        return True


def check_chain(path: Path) -> None:
    """Check that the chain of directories is whole.

    Raises
    ------
    FileFormatError
        If it leads out of the file, as when that is cut short, or in a circle.
    """
    _walk(path)


def _walk(path: Path, enough: int = 0) -> tuple[int, bool]:
    """Return the number of pictures (or `enough`), and whether the first stands for a stack."""
    size, pictures, stack = path.stat().st_size, 0, False
    seen: set[int] = set()
    with open(path, "rb") as file:
        layout = _Layout("<" if file.read(2) == b"II" else ">", file.read(2) in (b"+\0", b"\0+"))
        file.seek(8 if layout.big else 4)
        at = int(_read(file, layout.offset, size)[0])
        while at:
            if at in seen or at >= size:
                raise FileFormatError(
                    f"{path.name} is cut short or damaged: picture {len(seen) + 1} should begin at "
                    f"byte {at} of {size}"
                )
            seen.add(at)
            file.seek(at)
            tags = _read(file, layout.tag, size, int(_read(file, layout.count, size)[0]))
            at = int(_read(file, layout.offset, size)[0])
            _check_values(tags, layout, size)
            stack = stack or (len(seen) == 1 and _is_stack(file, tags, layout))
            pictures += not _is_reduced(tags, layout)
            if enough and pictures >= enough:
                break
    return pictures, stack


def _read(file: IO[bytes], dtype: np.dtype | str, size: int, count: int = 1) -> np.ndarray:
    dtype = np.dtype(dtype)
    if count * dtype.itemsize > size:
        raise FileFormatError(f"a directory claims {count} tags, more than the file can hold")
    data = file.read(count * dtype.itemsize)
    if len(data) < count * dtype.itemsize:
        raise FileFormatError(f"it is cut short: a directory should go on at byte {file.tell()}")
    return np.frombuffer(data, dtype)


def _check_values(tags: np.ndarray, layout: _Layout, size: int) -> None:
    public = tags[(tags["code"] < _FIRST_PRIVATE) & (tags["type"] < len(_TYPE_SIZES))]
    lengths = public["length"].astype(float) * _TYPE_SIZES[public["type"]]
    elsewhere = lengths > np.dtype(layout.offset).itemsize
    ends = public["value"].astype(float) + lengths
    if np.any(ends[elsewhere] > size):
        raise FileFormatError(
            f"it is cut short or damaged: tags point to byte {ends[elsewhere].max():.0f} of {size}"
        )


def _value(tags: np.ndarray, code: int, layout: _Layout) -> int:
    """Return a small number that is in the tag itself; zero if there is none."""
    found = tags[tags["code"] == code]
    if not len(found):
        return 0
    short = found["type"][0] == 3
    return int(found["value"][:1].view(f"{layout.order}u2")[0] if short else found["value"][0])


def _is_reduced(tags: np.ndarray, layout: _Layout) -> bool:
    return bool(_value(tags, _SUBFILE, layout) & _REDUCED)


def _is_stack(file: IO[bytes], tags: np.ndarray, layout: _Layout) -> bool:
    if _value(tags, _DEPTH, layout) > 1:
        return True
    text = tags[tags["code"] == _DESCRIPTION]
    if not len(text):
        return False
    before = file.tell()
    file.seek(int(text["value"][0]))
    found = _STACK.search(file.read(min(int(text["length"][0]), _LONGEST_TEXT)))
    file.seek(before)
    return found is not None
