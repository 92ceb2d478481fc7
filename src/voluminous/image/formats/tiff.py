"""TIFF: intensities in float32, which image editors and viewers open."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from ...packages import require
from .. import metadata
from ..arguments import narrowed
from ..tone import over_black

if TYPE_CHECKING:
    from ..image import Image

_BOTTOM_LEFT = 4  # the Orientation tag: the first row is the lowest
_ASSOCIATED, _UNASSOCIATED = 1, 2  # the ExtraSamples tag: colours (not) multiplied with alpha


def write(image: Image, path: Path) -> None:
    """Write the intensities, rounded to float32; channels after the third are extra samples."""
    tifffile = require("tifffile", "tiff", "writing TIFF")
    channels = image.channels
    rgb = channels >= 3
    pixels = narrowed(image.intensity[::-1], np.float32, "intensity")
    tifffile.imwrite(
        path,
        # tifffile would interpret a last axis of length one as columns.
        pixels[..., 0] if channels == 1 else pixels,
        photometric="rgb" if rgb else "minisblack",
        planarconfig="contig",
        # Explicit, because a fourth channel would be interpreted as alpha otherwise.
        extrasamples=["unspecified"] * (channels - (3 if rgb else 1)),
        description=metadata.dumps(image),
        software=metadata.KEY,
        metadata=None,
        compression="zlib",
    )


def read(path: Path) -> dict[str, Any]:
    """Read the first picture of a TIFF file; integers keep their values."""
    tifffile = require("tifffile", "tiff", "reading TIFF")
    with _quiet(), tifffile.TiffFile(path) as file:
        page: Any = file.pages.first
        needed, found = math.prod(page.chunked), len(page.dataoffsets)
        if found < needed:  # tifffile would fill the rest with zeros
            raise FileFormatError(
                f"the picture has {needed} strips or tiles, the file holds {found}"
            )
        pixels = page.asarray()
        if page.axes == "YX":
            pixels = pixels[..., None]
        elif page.axes == "SYX":
            pixels = np.moveaxis(pixels, 0, -1)
        elif page.axes != "YXS":
            raise FileFormatError(f"expected a picture with rows and columns, got axes {page.axes}")
        upright = page.tags.valueof("Orientation", 1) == _BOTTOM_LEFT
        extra = [int(kind) for kind in page.extrasamples]
        text = page.description
    pixels = pixels if upright else pixels[::-1]
    image = {"intensity": pixels}
    if extra in ([_ASSOCIATED], [_UNASSOCIATED]):
        image = over_black(pixels, multiplied=extra == [_ASSOCIATED])
    return image | metadata.loads(text, pixels.shape)


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress tifffile's log messages about damaged tags; the error reports them once."""
    logger = logging.getLogger("tifffile")
    before, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = before
