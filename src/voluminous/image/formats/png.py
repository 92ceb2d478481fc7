"""PNG: display values in 8 or 16 bits, for looking at."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from .. import metadata, tone
from . import png_code
from .contract import Format

if TYPE_CHECKING:
    from ..annotate import Annotated
    from ..image import Image

_TYPES: dict[int, type[np.uint8] | type[np.uint16]] = {8: np.uint8, 16: np.uint16}
_BIT_DEPTH_AT = 24  # its place in the file: signature, chunk head, width, height


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
        Add alpha = 1 − mean transparency, or as much more as the colours need: light that comes
        from a fully transparent place cannot be told by alpha 0.
    annotate : bool or dict
        Add what `Image.annotate` does; a dict has its options.
    **display
        Options of `Image.to_rgb`.

    Raises
    ------
    InputError
        If `bits` is something else, or the transparency is needed and not known.
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
    return png_code.encode(pixels, {"Software": metadata.KEY, metadata.KEY: metadata.dumps(image)})


def annotated(image: Image, annotate: Any, options: dict[str, Any]) -> Annotated:
    """Return what ``annotate=`` of `Image.save` asks for, with other options of the format."""
    if annotate is not True and not isinstance(annotate, dict):
        raise InputError(f"annotate must be True or a dict of options, got {annotate!r}")
    return image.annotate(**options, **({} if annotate is True else annotate))


def display_values(image: Image, transparent: bool, display: dict[str, Any]) -> NDArray[Any]:
    """Return what is shown, from 0 to 1, shape (ny, nx, 3), or 4 with alpha."""
    shown = image.to_rgb(**display)
    return _with_alpha(shown, image.transparency) if transparent else shown


def _with_alpha(rgb: NDArray[np.float32], transparency: NDArray[Any] | None) -> NDArray[Any]:
    """Return straight (not premultiplied) RGBA that looks like `rgb` in front of black."""
    if transparency is None:
        raise InputError("transparent=True needs an image whose transparency is known")
    through = np.clip(np.nan_to_num(transparency.mean(axis=-1, keepdims=True)), 0, 1)
    alpha = np.maximum(1 - through, rgb.max(axis=-1, keepdims=True))
    return np.concatenate([rgb / np.where(alpha > 0, alpha, 1), alpha], axis=-1)


def write(image: Image, path: Path, **options: Any) -> None:
    """Write the display values; see `encode`."""
    path.write_bytes(encode(image, **options))


def read(path: Path) -> dict[str, Any]:
    """Read display values from 0 to 1, from any kind of PNG.

    Alpha becomes transparency, and the colours what they are in front of black.
    """
    from PIL import Image as Pillow

    with Pillow.open(path) as file:
        file.load()
        text = getattr(file, "text", {}).get(metadata.KEY)
        content = path.read_bytes()
        pixels = png_code.decode16(content) if content[_BIT_DEPTH_AT] == 16 else _eight_bits(file)
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
    (png_code.SIGNATURE,),
    write,
    read,
    frozenset({"bits", "transparent", "annotate"}) | tone.OPTIONS,
)
