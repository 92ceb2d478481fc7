"""A picture with its annotations: pixels to look at, and a figure for files with lines and text."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...errors import unknown_name
from ...files import as_path, replacing
from .. import metadata
from ..formats import png_code

if TYPE_CHECKING:
    from ..image import Image
    from .sheet import Sheet

# Where lines and letters stay lines and letters.
_VECTOR = (".pdf", ".svg")
SUFFIXES = (".png", *_VECTOR)


class Annotated:
    """What `Image.annotate` returns.

    Attributes
    ----------
    rgba : uint8 array (ny, nx, 4)
        Red, green, blue and alpha (straight) of the whole sheet; row 0 is at the bottom.
    box : (int, int, int, int)
        Where the picture is in it: left, right, bottom, top, in pixels.
    figure : matplotlib Figure
        The annotations alone, 72 dots per inch; one pixel is one point.
    image : Image
        What was annotated.
    """

    def __init__(self, image: Image, sheet: Sheet) -> None:
        self.image, self._sheet = image, sheet
        self.rgba = sheet.pixels_drawn()
        self.box, self.figure = sheet.box, sheet.figure

    @property
    def picture(self) -> NDArray[np.uint8]:
        """The part of `rgba` where the picture is, with what is drawn over it."""
        left, right, bottom, top = self.box
        return self.rgba[bottom:top, left:right]

    def png(self) -> bytes:
        """Return a PNG file, which carries what the image knows of itself."""
        opaque = (self.rgba[..., 3] == 255).all()
        pixels = np.ascontiguousarray(self.rgba[::-1, :, : 3 if opaque else 4])
        texts = {"Software": metadata.KEY, metadata.KEY: metadata.dumps(self.image)}
        return png_code.encode(pixels, texts)

    def save(self, path: str | Path) -> None:
        """Write a file: ``.png``, or ``.pdf`` and ``.svg`` with sharp text in any size.

        Raises
        ------
        UnknownNameError
            If its suffix is another.
        MissingPathError
            If the directory does not exist.
        """
        path = as_path(path)
        suffix = path.suffix.lower()
        if suffix not in SUFFIXES:
            raise unknown_name("format of annotated pictures", suffix, SUFFIXES)
        content = self.png() if suffix == ".png" else self.vector(suffix[1:])
        with replacing(path) as temporary:
            temporary.write_bytes(content)

    def vector(self, format: str) -> bytes:
        """Return a "pdf" or "svg" file with the picture's pixels below lines and text."""
        left, _, bottom, _ = self.box
        paper, plain = self._sheet.paper or "none", self._sheet.pixels
        below = self.figure.figimage(plain, left, bottom, origin="lower", zorder=-1)
        stream = io.BytesIO()
        try:
            self.figure.savefig(stream, format=format, dpi=72, facecolor=paper)
        finally:
            below.remove()
        return stream.getvalue()

    def _repr_png_(self) -> bytes:
        return self.png()

    def __repr__(self) -> str:
        (height, width), (ny, nx) = self.rgba.shape[:2], self.picture.shape[:2]
        return f"<Annotated picture of {nx}×{ny} pixels on a sheet of {width}×{height}>"
