"""Anaglyphs: two eyes' pictures in one, separated by coloured glasses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError

if TYPE_CHECKING:
    from .image import Image

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # ITU-R BT.709


def anaglyph(image: Image) -> Image:
    """See `Image.anaglyph`."""
    stereo = (image.camera or {}).get("stereo")
    if stereo is None:
        raise InputError("an anaglyph needs a picture by a camera with stereo='side-by-side'")
    if image.channels not in (1, 3):
        raise InputError(f"an anaglyph needs one channel or three, got {image.channels}")
    axis = 1 if stereo == "side-by-side" else 0
    first, second = np.split(image.intensity, 2, axis=axis)
    left, right = (first, second) if axis == 1 else (second, first)  # row 0 is at the bottom
    weights = _LUMINANCE if image.channels == 3 else np.ones(1)
    red = (left @ weights.astype(left.dtype))[..., None]
    beside = right[..., 1:] if image.channels == 3 else np.repeat(right, 2, axis=-1)
    ny, nx, _ = right.shape
    return type(image)(
        np.concatenate([red, beside], axis=-1),
        x=image.x[-nx:],
        y=image.y[-ny:],
        unit=image.unit,
        intensity_unit=image.intensity_unit,
        pixel_size=image.pixel_size,
        camera=image.camera,
        provenance=image.provenance,
    )
