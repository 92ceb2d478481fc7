"""OpenEXR: float32 or half intensities with alpha, for compositing programs."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from ...packages import require
from .. import metadata
from ..arguments import narrowed

if TYPE_CHECKING:
    from ..image import Image

Layers = dict[str, np.ndarray]
_PLANES = ("transparency", "optical_depth")


def _library() -> Any:
    return require("OpenEXR", "exr", "an OpenEXR image")


def _names(channels: int) -> list[str]:
    if channels == 1:
        return ["Y"]
    return [*"RGB"[:channels], *(f"channel.{i}" for i in range(3, channels))]


def write(image: Image, path: Path, *, half: bool = False) -> None:
    """Write intensities, alpha, transparency and optical depth as channels of one part.

    Intensity with alpha = 1 − transparency is a premultiplied colour in the sense of compositing:
    over another picture B it gives intensity + transparency · B.
    """
    openexr = _library()
    kind = np.float16 if half else np.float32
    layers = _layers(narrowed(image.intensity, kind, "intensity"), "")
    for name, plane in metadata.planes(image):
        if name in _PLANES:
            layers |= _layers(narrowed(plane, np.float32, name), f"{name}.")
    if image.transparency is not None:
        layers["A"] = (1 - image.transparency.mean(axis=-1)).astype(kind)
    header = {
        "compression": openexr.ZIP_COMPRESSION,
        "type": openexr.scanlineimage,
        "pixelAspectRatio": abs(image.pixel_size[0] / image.pixel_size[1]),
        metadata.KEY: metadata.dumps(image),
    }
    # OpenEXR assumes C order and ignores the strides.
    pixels = {key: np.ascontiguousarray(plane[::-1]) for key, plane in layers.items()}
    openexr.File(header, pixels).write(str(path))


def _layers(planes: np.ndarray, prefix: str) -> Layers:
    return {prefix + name: planes[..., i] for i, name in enumerate(_names(planes.shape[-1]))}


def read(path: Path) -> dict[str, Any]:
    """Read the first part of an EXR file: RGB, grey, our channels, or else all channels by name."""
    openexr = _library()
    # For a damaged file OpenEXR prints the reason and returns a file without parts.
    with redirect_stdout(io.StringIO()), openexr.File(str(path), separate_channels=True) as file:
        layers = {name: channel.pixels[::-1] for name, channel in file.channels().items()}
        text = file.header().get(metadata.KEY)
    intensity = _stacked(layers, "")
    if intensity is None:
        shown = [layers[name] for name in sorted(layers) if name != "A"]
        if len({plane.shape for plane in shown}) != 1:
            raise FileFormatError(f"expected channels of one size, got {', '.join(sorted(layers))}")
        intensity = np.stack(shown, axis=-1)
    image = {"intensity": intensity}
    if "A" in layers:
        image["transparency"] = 1 - layers["A"]
    image |= {n: planes for n in _PLANES if (planes := _stacked(layers, f"{n}.")) is not None}
    return image | metadata.loads(text, intensity.shape)


def _stacked(layers: Layers, prefix: str) -> np.ndarray | None:
    known = ["Y"] if f"{prefix}Y" in layers else _names(len(layers) + 2)
    planes = [layers[prefix + name] for name in takewhile(lambda n: prefix + n in layers, known)]
    return np.stack(planes, axis=-1) if planes else None
