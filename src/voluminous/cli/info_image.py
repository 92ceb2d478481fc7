"""What `voluminous info` tells of an image."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from .statistics import numbers, statistics

if TYPE_CHECKING:
    from ..image import Image


def describe_image(path: Path) -> Iterator[str]:
    """Yield lines about an image file."""
    from ..image import Image

    image = Image.load(path)
    ny, nx, channels = image.shape
    left, right, bottom, top = image.extent
    yield f"{path}: an image of {nx} x {ny} pixels, {channels} channel{'s' * (channels > 1)}"
    yield f"x {left:g} … {right:g}, y {bottom:g} … {top:g} {image.unit}".rstrip()
    yield ""
    yield f"intensity {image.intensity.dtype} {image.intensity_unit}".rstrip()
    for channel in range(channels):
        yield f"  channel {channel}: {numbers(statistics(image.intensity[..., channel]))}"
    for name in ("optical_depth", "transparency"):
        plane = getattr(image, name)
        if plane is not None:
            yield f"{name}: {numbers(statistics(plane))}"
    yield from _story(image)
    yield ""
    yield from _next(path, image)


def _story(image: Image) -> Iterator[str]:
    for title, known in (("camera", image.camera), ("made by", image.provenance)):
        if known:
            plain = {k: v for k, v in known.items() if not isinstance(v, dict)}
            yield f"{title}: " + ", ".join(f"{key} {value}" for key, value in plain.items())


def _next(path: Path, image: Image) -> Iterator[str]:
    name = shlex.quote(str(path))
    if (image.provenance or {}).get("scene"):
        yield "It carries its scene. Look at it from elsewhere:"
        yield f"  voluminous render {name} -o again.png --set camera.incl=40"
    yield "Next, in Python:"
    yield "  import voluminous as vm"
    yield f"  image = vm.Image.load({str(path)!r})"
    yield "  image.plot(scale_bar=True)"
