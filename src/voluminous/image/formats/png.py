"""PNG with 16 bits per colour, which Pillow lacks; also 8 bits, faster and smaller than Pillow's.

Follows the PNG specification (W3C, third edition): chunks (section 5), filters (section 9).
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError, InputError
from .. import metadata, tone
from ..tone import display_values
from .contract import Format

if TYPE_CHECKING:
    from ..image import Image


_TYPES: dict[int, type[np.uint8] | type[np.uint16]] = {8: np.uint8, 16: np.uint16}
SIGNATURE = b"\x89PNG\r\n\x1a\n"
_BIT_DEPTH_AT = 24  # offset in the file: after signature, chunk header, width, height


def encode(
    image: Image,
    *,
    bits: int = 8,
    transparent: bool = False,
    annotate: bool | dict[str, Any] = False,
    **display: Any,
) -> bytes:
    """Return a PNG file of the display values.

    Parameters
    ----------
    image : Image
        What to show.
    bits : {8, 16}
        Bits per colour.
    transparent : bool
        Add alpha = 1 − mean transparency, raised where the colours need it: alpha 0 cannot
        represent emission from a fully transparent region.
    annotate : bool or dict
        Add the annotations of `Image.annotate`; a dict holds its options.
    **display
        Options of `Image.to_rgb`.
    """
    if bits not in tuple(_TYPES):
        raise InputError(f"bits must be 8 or 16, got {bits!r}")
    if annotate is not False:
        if bits != 8:
            raise InputError("annotated pictures have 8 bits; leave bits= out, or annotate=")
        return annotated(image, annotate, {**display, "transparent": transparent}).png()
    shown = display_values(image, transparent, display)
    top = 2**bits - 1
    pixels = np.rint(shown[::-1] * np.float32(top)).astype(_TYPES[bits])
    return encode_pixels(pixels, {"Software": metadata.KEY, metadata.KEY: metadata.dumps(image)})


def annotated(image: Image, annotate: Any, options: dict[str, Any]) -> Any:
    """Return the annotated picture for ``annotate=`` of `Image.save`."""
    if annotate is not True and not isinstance(annotate, dict):
        raise InputError(f"annotate must be True or a dict of options, got {annotate!r}")
    return image.annotate(**options, **({} if annotate is True else annotate))


def write(image: Image, path: Path, **options: Any) -> None:
    """Write the display values; see `encode`."""
    path.write_bytes(encode(image, **options))


def read(path: Path) -> dict[str, Any]:
    """Read display values from 0 to 1, from any kind of PNG.

    Alpha becomes transparency, and the colours are composited over black.
    """
    from PIL import Image as Pillow

    with Pillow.open(path) as file:
        file.load()
        text = getattr(file, "text", {}).get(metadata.KEY)
        content = path.read_bytes()
        pixels = decode16(content) if content[_BIT_DEPTH_AT] == 16 else _eight_bits(file)
    image = _without_alpha(pixels[::-1] / np.float32(np.iinfo(pixels.dtype).max))
    known = metadata.loads(text, pixels.shape)
    known.pop("intensity_unit", None)  # display values have none
    return image | known


def _eight_bits(file: Any) -> NDArray[np.uint8]:
    if file.mode not in ("L", "LA", "RGB", "RGBA") or "transparency" in file.info:
        file = file.convert("RGBA" if "transparency" in file.info else _plain_mode(file.mode))
    pixels = np.asarray(file)
    return pixels[..., None] if pixels.ndim == 2 else pixels


def _plain_mode(mode: str) -> str:
    return "L" if mode == "1" else "RGB"


def _without_alpha(samples: NDArray[np.float32]) -> dict[str, Any]:
    if samples.shape[-1] in (1, 3):
        return {"intensity": samples}
    colors, alpha = samples[..., :-1], samples[..., -1:]
    return {"intensity": colors * alpha, "transparency": 1 - alpha}


FORMAT = Format(
    "a PNG image",
    (".png",),
    (SIGNATURE,),
    write,
    read,
    frozenset({"bits", "transparent", "annotate"}) | tone.OPTIONS,
)


_COLOR_TYPE = {1: 0, 2: 4, 3: 2, 4: 6}  # samples per pixel: grey, grey + alpha, RGB, RGBA
_SAMPLES = {kind: samples for samples, kind in _COLOR_TYPE.items()}
_UP = 2
# Readers refuse compressed texts that unpack to more than this, but accept uncompressed ones.
_LONGEST_PACKED_TEXT = 1_000_000


def encode_pixels(pixels: NDArray[np.uint8] | NDArray[np.uint16], texts: dict[str, str]) -> bytes:
    """Return a PNG file.

    Parameters
    ----------
    pixels : array of uint8 or uint16, shape (rows from the top, columns, samples)
        1 to 4 samples: grey, grey and alpha, RGB, RGBA.
    texts : dict
        Latin-1 texts by keyword.
    """
    rows, columns, samples = pixels.shape
    bits = 8 * pixels.dtype.itemsize
    header = struct.pack(">2I5B", columns, rows, bits, _COLOR_TYPE[samples], 0, 0, 0)
    return b"".join(
        [
            SIGNATURE,
            _chunk(b"IHDR", header),
            _chunk(b"sRGB", b"\x00"),  # the values are display values already
            *(_text(key, text) for key, text in texts.items()),
            _chunk(b"IDAT", zlib.compress(_filtered(pixels))),
            _chunk(b"IEND", b""),
        ]
    )


def _filtered(pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Return all rows minus the row above ("up" filter): smooth pictures compress better."""
    rows = pixels.shape[0]
    raw = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(rows, -1).view(np.uint8)
    packed = np.empty((rows, 1 + raw.shape[1]), dtype=np.uint8)
    packed[:, 0] = _UP
    packed[0, 1:] = raw[0]
    np.subtract(raw[1:], raw[:-1], out=packed[1:, 1:])
    return packed.tobytes()


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _text(key: str, text: str) -> bytes:
    content = text.encode("latin-1")
    if len(content) > _LONGEST_PACKED_TEXT:
        return _chunk(b"tEXt", key.encode("latin-1") + b"\0" + content)
    return _chunk(b"zTXt", key.encode("latin-1") + b"\0\0" + zlib.compress(content))


def decode16(content: bytes) -> NDArray[np.uint16]:
    """Return the pixels of a PNG file with 16 bits per sample, the top row first."""
    chunks = _chunks(content)
    columns, rows, bits, kind, _, _, interlaced = struct.unpack(">2I5B", chunks[b"IHDR"])
    if interlaced:
        raise FileFormatError("interlaced 16-bit PNG images cannot be read; save it without")
    if bits != 16 or kind not in _SAMPLES:
        raise FileFormatError(f"expected 16 bits per colour, got {bits} (colour type {kind})")
    samples = _SAMPLES[kind]
    packed = zlib.decompress(chunks[b"IDAT"])
    lines = np.frombuffer(packed, np.uint8).reshape(rows, 1 + 2 * samples * columns)
    raw = _unfiltered(lines[:, 0], lines[:, 1:], 2 * samples)
    return raw.view(">u2").astype(np.uint16).reshape(rows, columns, samples)


def _chunks(content: bytes) -> dict[bytes, bytes]:
    """Return the content of the chunks by type; chunks of the same type are concatenated."""
    found: dict[bytes, list[bytes]] = {}
    at = len(SIGNATURE)
    while b"IEND" not in found:
        length, kind = struct.unpack_from(">I4s", content, at)
        data = content[at + 8 : at + 8 + length]
        (check,) = struct.unpack_from(">I", content, at + 8 + length)
        if zlib.crc32(kind + data) != check:
            raise FileFormatError(f"the check sum of the chunk {kind!r} is wrong")
        found.setdefault(kind, []).append(data)
        at += 12 + length
    return {kind: b"".join(parts) for kind, parts in found.items()}


def _unfiltered(kinds: NDArray[np.uint8], rows: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    result = np.empty_like(rows, order="C")
    above = np.zeros(rows.shape[1], dtype=np.uint8)
    for kind, row, out in zip(kinds.tolist(), rows, result, strict=True):
        if kind == 0:
            out[:] = row
        elif kind == 1:
            out[:] = np.cumsum(row.reshape(-1, width), axis=0, dtype=np.uint8).ravel()
        elif kind == _UP:
            np.add(row, above, out=out)
        elif kind in (3, 4):
            out[:] = _from_neighbours(kind, row.tolist(), above.tolist(), width)
        else:
            raise FileFormatError(f"there is no PNG filter of kind {kind}")
        above = out
    return result


def _from_neighbours(kind: int, row: list[int], above: list[int], width: int) -> list[int]:
    """Undo the filters that need the finished pixel to the left: average (3) and Paeth (4)."""
    done = [0] * width + row
    corner = [0] * width + above
    for i, value in enumerate(row):
        left, up = done[i], above[i]
        guess = (left + up) // 2 if kind == 3 else _paeth(left, up, corner[i])
        done[i + width] = (value + guess) & 0xFF
    return done[width:]


def _paeth(left: int, up: int, corner: int) -> int:
    """Return the neighbour closest to left + up − corner; ties resolve in this order."""
    to_left, to_up = abs(up - corner), abs(left - corner)
    to_corner = abs(left + up - 2 * corner)
    if to_left <= to_up and to_left <= to_corner:
        return left
    return up if to_up <= to_corner else corner
