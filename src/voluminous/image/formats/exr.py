"""OpenEXR: float32 or half intensities with alpha, for compositing programs."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from .. import metadata
from ..arguments import gathered, narrowed
from .contract import Format

if TYPE_CHECKING:
    from ..image import Image

Layers = dict[str, NDArray[Any]]
_PLANES = ("transparency", "optical_depth")
_EXTRA = "channel."


def _names(channels: int) -> list[str]:
    if channels == 1:
        return ["Y"]
    return ["R", "G", "B"][:channels] + [f"{_EXTRA}{i}" for i in range(3, channels)]


def write(image: Image, path: Path, *, half: bool = False) -> None:
    """Write intensities, alpha, transparency and optical depth as channels of one part.

    Intensity with alpha = 1 − transparency is a premultiplied colour in the sense of compositing:
    over another picture B it gives intensity + transparency · B.
    """
    import OpenEXR

    kind = np.float16 if half else np.float32
    layers = _layers(narrowed(image.intensity, kind, "intensity"), "")
    for name in _PLANES:
        plane = getattr(image, name)
        if plane is not None:
            layers |= _layers(narrowed(gathered(plane), np.float32, name), f"{name}.")
    if image.transparency is not None:
        layers["A"] = (1 - image.transparency.mean(axis=-1)).astype(kind)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "pixelAspectRatio": abs(image.pixel_size[0] / image.pixel_size[1]),
        metadata.KEY: metadata.dumps(image),
    }
    # OpenEXR assumes C order and ignores the strides.
    pixels = {key: np.ascontiguousarray(plane[::-1]) for key, plane in layers.items()}
    OpenEXR.File(header, pixels).write(str(path))


def _layers(planes: NDArray[Any], prefix: str) -> Layers:
    return {prefix + name: planes[..., i] for i, name in enumerate(_names(planes.shape[-1]))}


def read(path: Path) -> dict[str, Any]:
    """Read the first part of an EXR file: RGB, grey, our channels, or else all channels by name."""
    import OpenEXR

    # For a damaged file OpenEXR prints the reason and returns a file without parts.
    with redirect_stdout(io.StringIO()), OpenEXR.File(str(path), separate_channels=True) as file:
        layers = {name: channel.pixels[::-1] for name, channel in file.channels().items()}
        text = file.header().get(metadata.KEY)
    intensity = _stacked(layers, "")
    if intensity is None:
        intensity = _all(layers)
    image = {"intensity": intensity}
    if "A" in layers:
        image["transparency"] = 1 - layers["A"]
    image |= {n: planes for n in _PLANES if (planes := _stacked(layers, f"{n}.")) is not None}
    return image | metadata.loads(text, intensity.shape)


def _stacked(layers: Layers, prefix: str) -> NDArray[Any] | None:
    names = [prefix + "Y"] if prefix + "Y" in layers else _counted(layers, prefix)
    return np.stack([layers[name] for name in names], axis=-1) if names else None


def _counted(layers: Layers, prefix: str) -> list[str]:
    count = 0
    while prefix + _names(max(count + 1, 2))[count] in layers:
        count += 1
    return [prefix + name for name in _names(max(count, 2))[:count]]


def _all(layers: Layers) -> NDArray[Any]:
    planes = [layers[name] for name in sorted(layers) if name != "A"]
    if len({plane.shape for plane in planes}) != 1:
        raise FileFormatError(f"expected channels of one size, got {', '.join(sorted(layers))}")
    return np.stack(planes, axis=-1)


FORMAT = Format("an OpenEXR image", (".exr",), (b"v/1\x01",), write, read, frozenset({"half"}))
