"""TIFF: intensities in float32, which image editors and viewers open."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from .. import metadata
from ..arguments import narrowed
from .contract import Format

if TYPE_CHECKING:
    from ..image import Image

# Maximum compression ratio of Deflate, the highest among the usual methods.
_MOST_PACKED = 1032
_LARGE_SAMPLES = 10_000_000
_BOTTOM_LEFT = 4  # the Orientation tag: the first row is the lowest
_ASSOCIATED, _UNASSOCIATED = 1, 2  # the ExtraSamples tag: colours (not) multiplied with alpha


def write(image: Image, path: Path) -> None:
    """Write the intensities, rounded to float32; channels after the third are extra samples."""
    import tifffile

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
    import tifffile

    with _quiet(), tifffile.TiffFile(path) as file:
        page = file.pages.first
        _check_sizes(page, path.stat().st_size)
        pixels = _channels_last(page)
        upright = page.tags.valueof("Orientation", 1) == _BOTTOM_LEFT
        extra = tuple(int(kind) for kind in page.extrasamples)
        text = page.description
    pixels = pixels if upright else pixels[::-1]
    return _without_alpha(pixels, extra) | metadata.loads(text, pixels.shape)


def _check_sizes(page: Any, stored: int) -> None:
    needed, found = math.prod(page.chunked), len(page.dataoffsets)
    if found < needed:
        raise FileFormatError(f"the picture has {needed} strips or tiles, the file holds {found}")
    samples = max(math.prod(page.shape), math.prod(page.chunks) * needed)
    if samples > _LARGE_SAMPLES and samples > _MOST_PACKED * stored:
        raise FileFormatError(f"{stored} bytes cannot hold the {samples} values they claim to")


def _channels_last(page: Any) -> NDArray[Any]:
    pixels = page.asarray()
    if page.axes == "YX":
        return pixels[..., None]
    if page.axes == "SYX":
        return np.moveaxis(pixels, 0, -1)
    if page.axes != "YXS":
        raise FileFormatError(f"expected a picture with rows and columns, got axes {page.axes}")
    return pixels


def _without_alpha(pixels: NDArray[Any], extra: tuple[int, ...]) -> dict[str, Any]:
    if len(extra) != 1 or extra[0] not in (_ASSOCIATED, _UNASSOCIATED):
        return {"intensity": pixels}
    full = np.iinfo(pixels.dtype).max if pixels.dtype.kind in "iu" else 1.0
    colors, alpha = pixels[..., :-1], pixels[..., -1:] / full
    return {
        "intensity": colors * alpha if extra[0] == _UNASSOCIATED else colors,
        "transparency": 1 - alpha,
    }


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress tifffile's log messages about damaged tags; the error reports them once."""
    logger = logging.getLogger("tifffile")
    before, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = before


FORMAT = Format(
    "a TIFF image",
    (".tif", ".tiff"),
    (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
    write,
    read,
)
