"""JPEG, PDF and SVG: display values for papers and web pages, without coordinates and units."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from .. import tone
from .contract import Format
from .png import annotated

if TYPE_CHECKING:
    from ..image import Image

_BARE = dict.fromkeys(("scale_bar", "triad", "compass", "color_bar", "time"), False)


def write_jpeg(
    image: Image, path: Path, *, quality: int = 95, annotate: Any = False, **display: Any
) -> None:
    """Write the display values, lossy; `quality` is from 1 to 100."""
    from PIL import Image as Pillow

    if not isinstance(quality, int) or not 1 <= quality <= 100:
        raise InputError(f"quality must be a whole number from 1 to 100, got {quality!r}")
    if annotate is False:
        pixels = np.rint(np.asarray(image.to_rgb(**display))[::-1] * np.float32(255)).astype(
            np.uint8
        )
    else:
        pixels = annotated(image, annotate, display).rgba[::-1, :, :3]
    # No chroma subsampling: thin coloured lines on black would fade.
    picture = Pillow.fromarray(np.ascontiguousarray(pixels))
    picture.save(path, "JPEG", quality=quality, subsampling=0)


def read_jpeg(path: Path) -> dict[str, Any]:
    """Read display values from 0 to 1."""
    from PIL import Image as Pillow

    with Pillow.open(path) as file:
        pixels = np.asarray(file.convert("RGB"))
    return {"intensity": pixels[::-1] / np.float32(255)}


def _vector(suffix: str, name: str, magic: tuple[bytes, ...]) -> Format:
    """Return a vector format: the picture as pixels, lines and letters as vectors."""

    def write(image: Image, path: Path, *, annotate: Any = False, **display: Any) -> None:
        options = _BARE if annotate is False else annotate
        path.write_bytes(annotated(image, options, display).vector(suffix[1:]))

    def read(path: Path) -> dict[str, Any]:
        raise FileFormatError(f"{name} holds a page, not an image; load the .png or .fits")

    options = frozenset({"transparent", "annotate"}) | tone.OPTIONS
    return Format(name, (suffix,), magic, write, read, options)


JPEG = Format(
    "a JPEG image",
    (".jpg", ".jpeg"),
    (b"\xff\xd8\xff",),
    write_jpeg,
    read_jpeg,
    frozenset({"quality", "annotate"}) | tone.OPTIONS,
)
PDF = _vector(".pdf", "a PDF file", (b"%PDF",))
SVG = _vector(".svg", "an SVG file", (b"<?xml", b"<svg"))
