"""Fits cameras to the visible part of a medium: data often fill a small part of their box."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..calibration import calibrated, presets, suggest_medium
from ..calibration.samples import measurable
from ..cameras import Orthographic
from ..cameras.views import view_angles
from ..errors import InputError
from ..first_view import FIRST_INCL, FIRST_PHI
from ..media.contract import Medium
from ..volume import Volume
from .cache import Cache
from .prepare import prepare
from .run import run

if TYPE_CHECKING:
    from ..cameras.contract import Frame


# Pixels per side of a coarse picture that shows where the medium is visible:
_COARSE = 96
# brighter than the first fraction of the maximum, except for the second fraction of the total light
# (faint wisps).
_FAINT, _WISPS = 0.02, 2e-3
# The visible part fills the first fraction of the frame; a frame filled to the second is unchanged.
_FILLED, _FULL = 0.85, 0.7


def framed(
    volume: Volume,
    medium: Medium | None = None,
    incl: Any = None,
    phi: Any = None,
    *,
    view: str | None = None,
    resolution: Any = 400,
) -> Orthographic:
    """Return a camera around the visible part of a medium; see `Orthographic.framing`."""
    camera = first_camera(volume, incl, phi, view=view).replace(resolution=resolution)
    if medium is None:
        return camera
    scheme = None if "dual" in volume.grid.walk_kinds else "first-order"
    coarse = camera.replace(resolution=_COARSE)
    if isinstance(volume, Volume) and isinstance(medium, Medium):  # `prepare` refuses others
        medium = calibrated(medium, volume, Cache(volume).measurements)
        volume = measurable(volume)
    job, _ = prepare(volume, medium, coarse, scheme=scheme, tolerance=None)
    light = run(job, 0.0).emission.sum(axis=-1, dtype=np.float64)
    if not light.max() > 0.0:
        return camera
    limits = _limits(light, job.frame)
    size = [b - a + step for (a, b), step in zip(limits, job.frame.pixel, strict=True)]
    if max(size) > _FULL * _COARSE * job.frame.pixel[0]:
        return camera
    pixels = camera.resolution
    width = max(pixels) * max(s / n for s, n in zip(size, pixels, strict=True))
    return camera.replace(
        width=_rounded(width / _FILLED, width),
        shift=tuple(_rounded(0.5 * (a + b), width) for a, b in limits),
    )


def perspective(framing: Orthographic, volume: Volume, fov: float) -> tuple[Any, Any, np.ndarray]:
    """Return position, target and up vector of a perspective view; `fov` is in degrees.

    A cube as wide as the frame fills the picture with its front.
    """
    frame = framing.frame(volume.grid)
    center, right, up, into = frame.vectors[:4]
    target = center + frame.shift[0] * right + frame.shift[1] * up
    width = max(frame.width)
    away = 0.5 * width * (1.0 + 1.0 / np.tan(0.5 * np.deg2rad(fov)))
    return (target - away * into).tolist(), target.tolist(), up


def first_camera(
    volume: Volume, incl: Any = None, phi: Any = None, *, view: str | None = None
) -> Orthographic:
    """Return a camera that shows the whole volume from given angles, or in a view."""
    if incl is None and phi is None:
        return Orthographic(**view_angles(getattr(volume, "meta", {}), view))
    if view is not None:
        raise InputError(f"give angles or view={view!r}, not both")
    return Orthographic(FIRST_INCL if incl is None else incl, FIRST_PHI if phi is None else phi)


def _limits(light: np.ndarray, frame: Frame) -> list[tuple[float, float]]:
    """Return the limits of the visible part along both axes of the image plane."""
    light = np.where(light > _FAINT * light.max(), light, 0.0)
    limits = []
    for axis, places in enumerate(frame.coordinates()):
        total = np.cumsum(light.sum(axis=axis)) / max(light.sum(), 1e-300)
        first, last = np.searchsorted(total, [_WISPS, 1.0 - _WISPS])
        limits.append((places[first], places[min(last, len(places) - 1)]))
    return limits


def _rounded(value: float, size: float) -> float:
    """Return a length to a thousandth of the frame, short enough to be typed again."""
    return round(float(value), 3 - int(np.floor(np.log10(size))))


def first_medium(volume: Volume) -> Medium:
    """Return the volume's channels, or `suggest_medium` as cached for the last picture.

    The latter takes a second for a million cells of patches, the picture itself a tenth.
    """
    if has_channels(volume):
        return presets.fluorescence(volume)

    def key() -> Hashable:  # fields that are not read yet do not count
        read = [name for name in volume.fields if name not in volume.waiting]
        return "first medium", Cache(volume).statistics.digests(read)

    medium: Medium | None = Cache(volume).get(key())
    if medium is None:
        medium = suggest_medium(volume)
        Cache(volume).put(key(), medium)  # fields may have been read only now
    return medium


def has_channels(volume: Volume) -> bool:
    """Return whether all fields are microscope channels, and there are several."""
    channels = volume.meta.get("channels") or {}
    return len(channels) > 1 and all(name in channels for name in volume.fields)
