"""Compressed values: blocks that each unpack to exactly the announced number of bytes."""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from ...errors import FileFormatError
from ...packages import require

# No compressor makes data so many times smaller: zlib 1032, LZ4 255, LZMA some 7000.
MOST_PACKED = 10_000
# Blocks of VTK have 32 KiB or a few MiB.
_LARGEST_BLOCK = 1 << 30


class Stream(Protocol):
    """Bytes one after the other."""

    def read(self, size: int, /) -> bytes:
        """Return the next bytes; fewer only at the end."""
        ...


def decompressor(name: str) -> Callable[[bytes, int], bytes]:
    """Return the function (packed bytes, size) → bytes of a compressor, by VTK's name for it.

    Raises
    ------
    FileFormatError
        If VTK has no such compressor.
    MissingPackageError
        For LZ4, if the package for it is not installed.
    """
    known = {
        "vtkZLibDataCompressor": _zlib,
        "vtkLZMADataCompressor": _lzma,
        "vtkLZ4DataCompressor": _lz4,
    }
    if name not in known:
        raise FileFormatError(f"unknown compressor {name!r}; expected one of {', '.join(known)}")
    return known[name]


def unpack(stream: Stream, packed: int, size: int, head: np.dtype[Any], name: str) -> bytearray:
    """Return the bytes of compressed values.

    Parameters
    ----------
    stream : binary stream
        At the head: numbers of blocks, of bytes of a block and of the last one if it is smaller,
        then the packed size of each.
    packed : int
        Bytes that there are at most.
    size : int
        Bytes that all blocks must have together, unpacked.
    head : dtype
        Type of the numbers in the head.
    name : str
        The compressor.

    Raises
    ------
    FileFormatError
        If there are fewer or more.
    """
    count, block, last = (int(n) for n in _numbers(stream, 3, head))
    if count * head.itemsize > packed or size > MOST_PACKED * packed:
        raise FileFormatError(
            f"{count} compressed blocks for {size} bytes of values are announced, but there are "
            f"only {packed} bytes"
        )
    sizes = [block] * count
    if count and last:
        sizes[-1] = last
    if sum(sizes) != size or block > _LARGEST_BLOCK:
        raise FileFormatError(
            f"{count} compressed blocks of {block} bytes, the last of {last}, are announced; "
            f"expected {size} bytes of values"
        )
    packed_sizes = _numbers(stream, count, head)
    if sum(map(int, packed_sizes)) > packed:
        raise FileFormatError(f"compressed blocks of more than the {packed} bytes that are left")
    unpacked, out = decompressor(name), bytearray()
    for number, (length, expected) in enumerate(zip(packed_sizes, sizes, strict=True)):
        out += _block(unpacked, _exactly(stream, int(length)), expected, number)
    return out


def _block(unpacked: Any, packed: bytes, expected: int, number: int) -> bytes:
    try:
        data: bytes = unpacked(packed, expected)
    except (zlib.error, lzma.LZMAError, EOFError, RuntimeError) as error:
        raise FileFormatError(f"compressed block {number} is damaged ({error})") from error
    if len(data) != expected:
        raise FileFormatError(
            f"compressed block {number} holds {'more' if len(data) > expected else 'fewer'} than "
            f"the {expected} bytes announced"
        )
    return data


# Each is asked for one byte more than announced, never for all that a bomb would give.


def _zlib(packed: bytes, size: int) -> bytes:
    return zlib.decompressobj().decompress(packed, size + 1)


def _lzma(packed: bytes, size: int) -> bytes:
    return lzma.LZMADecompressor(memlimit=1 << 30).decompress(packed, size + 1)


def _lz4(packed: bytes, size: int) -> bytes:
    block = require("lz4.block", "vtk", "reading values that LZ4 compressed")
    data: bytes = block.decompress(packed, uncompressed_size=size)
    return data


def _numbers(stream: Stream, count: int, kind: np.dtype[Any]) -> np.ndarray:
    return np.frombuffer(_exactly(stream, count * kind.itemsize), kind)


def _exactly(stream: Stream, size: int) -> bytes:
    data = stream.read(size)
    if len(data) < size:
        raise FileFormatError(f"cut short: expected {size} bytes, got {len(data)}")
    return data
