"""Display values for papers and web pages: PNG, with all metadata, and JPEG, PDF and SVG, without.

Pillow writes no PNG of 16 bits per colour. `encode_pixels` does, after the PNG specification (W3C,
third edition), sections 5 (chunks) and 9 (filters); for 8 bits it is faster than Pillow.
"""

from __future__ import annotations

import functools
import io
import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError, InputError
from ...packages import require
from .. import metadata
from ..tone import display_values, over_black

if TYPE_CHECKING:
    from ..image import Image

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_BIT_DEPTH_AT = 24  # offset in the file: after signature, chunk header, width, height
_COLOR_TYPE = {1: 0, 2: 4, 3: 2, 4: 6}  # samples per pixel: grey, grey + alpha, RGB, RGBA
_UP = 2
# Of the compression: a third of the time of the usual 6, for files a twentieth to a fifth larger.
_LEVEL = 4
# Readers refuse compressed texts that unpack to more than this, but accept uncompressed ones.
_LONGEST_PACKED_TEXT = 1_000_000
_BARE = dict.fromkeys(("scale_bar", "triad", "compass", "color_bar", "time"), False)


def encode(
    image: Image,
    *,
    bits: int = 8,
    transparent: bool = False,
    annotate: bool | dict[str, Any] = False,
    **display: Any,
) -> bytes:
    """Return a PNG file of the display values, of 8 or 16 bits per colour.

    `transparent` adds alpha = 1 − mean transparency, raised where the colours need it: alpha 0
    cannot represent emission from a fully transparent region. `annotate` adds the annotations of
    `Image.annotate`; a dict holds its options. The others are those of `Image.to_rgb`.
    """
    if bits not in (8, 16):
        raise InputError(f"bits must be 8 or 16, got {bits!r}")
    if annotate is not False:
        if bits != 8:
            raise InputError("annotated pictures have 8 bits; leave bits= out, or annotate=")
        content: bytes = _annotated(image, annotate, {**display, "transparent": transparent}).png()
        return content
    pixels = display_values(image, transparent, display, bits)
    return encode_pixels(pixels[::-1], metadata.texts(image))


def _annotated(image: Image, annotate: Any, options: dict[str, Any]) -> Any:
    if annotate is not True and not isinstance(annotate, dict):
        raise InputError(f"annotate must be True or a dict of options, got {annotate!r}")
    return image.annotate(**options, **({} if annotate is True else annotate))


@functools.wraps(encode)
def write(image: Image, path: Path, **options: Any) -> None:
    """Write the display values; see `encode`."""
    path.write_bytes(encode(image, **options))


def read(path: Path) -> dict[str, Any]:
    """Read display values from 0 to 1, from any kind of PNG; alpha becomes transparency."""
    from PIL import Image as Pillow

    with Pillow.open(path) as file:
        file.load()
        text = file.info.get(metadata.KEY)
        content = path.read_bytes()
        if content[_BIT_DEPTH_AT] == 16:
            purpose = "reading PNG files of 16 bits per colour"
            pixels = require("imagecodecs", "tiff", purpose).png_decode(content)
        else:
            if "transparency" in file.info:
                mode = "RGBA"
            elif file.mode in ("L", "LA", "RGB", "RGBA"):
                mode = file.mode
            else:
                mode = "L" if file.mode == "1" else "RGB"
            pixels = np.asarray(file.convert(mode))
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    values = pixels[::-1] / np.float32(np.iinfo(pixels.dtype).max)
    has_alpha = values.shape[-1] in (2, 4)
    known = metadata.loads(text, pixels.shape)
    for name in ("intensity_unit", "spectral"):  # display values have none
        known.pop(name, None)
    return (over_black(values) if has_alpha else {"intensity": values}) | known


def write_jpeg(
    image: Image, path: Path, *, quality: int = 95, annotate: Any = False, **display: Any
) -> None:
    """Write the display values, lossy; `quality` is from 1 to 100."""
    from PIL import Image as Pillow

    if not isinstance(quality, int) or not 1 <= quality <= 100:
        raise InputError(f"quality must be a whole number from 1 to 100, got {quality!r}")
    if annotate is False:
        pixels = display_values(image, False, display, 8)
    else:
        pixels = _annotated(image, annotate, display).rgba[..., :3]
    # No chroma subsampling: thin coloured lines on black would fade.
    picture, content = Pillow.fromarray(np.ascontiguousarray(pixels[::-1])), io.BytesIO()
    picture.save(content, "JPEG", quality=quality, subsampling=0)
    path.write_bytes(content.getvalue())  # Pillow does not notice where a disk is full


def read_jpeg(path: Path) -> dict[str, Any]:
    """Read display values from 0 to 1."""
    from PIL import Image as Pillow

    with Pillow.open(path) as file:
        return {"intensity": np.asarray(file.convert("RGB"))[::-1] / np.float32(255)}


def write_page(
    image: Image, path: Path, *, transparent: bool = False, annotate: Any = False, **display: Any
) -> None:
    """Write a PDF or an SVG: the picture as pixels, lines and letters as vectors."""
    annotate = _BARE if annotate is False else annotate
    page = _annotated(image, annotate, {**display, "transparent": transparent})
    path.write_bytes(page.vector(path.suffix[1:].lower()))


def read_page(path: Path) -> dict[str, Any]:
    """Refuse."""
    raise FileFormatError("it holds a page, not an image; load the .png or .fits")


def encode_pixels(pixels: NDArray[np.uint8] | NDArray[np.uint16], texts: dict[str, str]) -> bytes:
    """Return a PNG file of pixels (rows from the top, columns, samples) and Latin-1 texts."""
    rows, columns, samples = pixels.shape
    bits = 8 * pixels.dtype.itemsize
    raw = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(rows, -1).view(np.uint8)
    packed = np.empty((rows, 1 + raw.shape[1]), dtype=np.uint8)
    # The "up" filter, each row minus the row above: smooth pictures compress better.
    packed[:, 0], packed[0, 1:] = _UP, raw[0]
    np.subtract(raw[1:], raw[:-1], out=packed[1:, 1:])
    header = struct.pack(">2I5B", columns, rows, bits, _COLOR_TYPE[samples], 0, 0, 0)
    parts = [(b"IHDR", header), (b"sRGB", b"\0")]
    for key, text in texts.items():
        content = text.encode("latin-1")
        if len(content) > _LONGEST_PACKED_TEXT:
            parts.append((b"tEXt", key.encode("latin-1") + b"\0" + content))
        else:
            parts.append((b"zTXt", key.encode("latin-1") + b"\0\0" + zlib.compress(content)))
    parts += [(b"IDAT", zlib.compress(packed.tobytes(), _LEVEL)), (b"IEND", b"")]
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
    return b"".join((SIGNATURE, *chunks))
