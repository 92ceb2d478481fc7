"""A frame around what there is to see: data often fill a small part of their box."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ..media import Medium
    from ..volume import Volume

# A picture of so many pixels tells where something is …
_COARSE = 96
# … brighter than this part of the brightest, but for this part of all its light (faint wisps).
_FAINT, _WISPS = 0.02, 2e-3
# What shows fills this part of the frame; one that is as full already is left alone.
_FILLED, _FULL = 0.85, 0.7


def framed(volume: Volume, medium: Medium, camera: dict[str, Any], scheme: str) -> dict[str, Any]:
    """Return width and shift of a square frame around what shows; nothing if the whole box is full.

    Parameters
    ----------
    camera : dict
        ``incl`` and ``phi``.
    scheme : str
        "first-order", or another for which errors need not be looked at.
    """
    from ..cameras import Orthographic
    from ..rendering import render

    whole = Orthographic(camera["incl"], camera["phi"], resolution=_COARSE)
    image = render(volume, medium, whole, scheme=scheme, tolerance=None)
    light = image.intensity.sum(axis=-1, dtype=np.float64)
    if not light.max() > 0.0 or image.x is None or image.y is None:
        return {}
    seen = light > _FAINT * light.max()
    spans = [_span(np.where(seen, light, 0.0).sum(axis=a)) for a in (0, 1)]
    limits = [(axis[a], axis[b]) for axis, (a, b) in zip((image.x, image.y), spans, strict=True)]
    size = max(b - a for a, b in limits) + max(image.pixel_size)
    if size > _FULL * _COARSE * image.pixel_size[0]:
        return {}
    middle = [float(_rounded(0.5 * (a + b), size)) for a, b in limits]
    return {"width": float(_rounded(size / _FILLED, size)), "shift": middle}


def _span(light: np.ndarray) -> tuple[int, int]:
    """Return the first and the last row with light, but for wisps."""
    total = np.cumsum(light) / max(light.sum(), 1e-300)
    first, last = np.searchsorted(total, [_WISPS, 1.0 - _WISPS])
    return int(first), int(min(last, len(light) - 1))


def _rounded(value: float, size: float) -> float:
    """Return a length to a thousandth of the frame: it is shown, and typed again."""
    step = 10.0 ** np.floor(np.log10(size) - 3)
    return float(np.round(value / step) * step)
