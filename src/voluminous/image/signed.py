"""Colormaps of pictures of one channel that ask for one, but name none."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import mixing
from .stretch import positive
from .tone import automatic_exposure, mixed_channels

# Blue comes, red goes, and white stands still, as astronomers draw it.
_SIGNED = "RdBu_r"
# Below zero by so much of what is above, at least: less is what a sum left over.
_SHARE = 0.1
# Percentiles of the values of a projection that are black and white.
_WINDOW = (0.5, 99.8)
# Who gives one of these has said how.
_DECIDING = ("background", "vmin", "vmax", "softening")


def with_colormap(
    intensity: NDArray[Any], options: dict[str, Any], projection: bool = False
) -> dict[str, Any]:
    """Return display options, with a colormap where one channel needs one and none is named.

    A norm bends the values of a colormap: then it is grey. One channel of both signs, of which
    nothing is said, has one around zero: in grey all that is negative would be black, half of a
    map of velocities. Where nothing is positive, as in depths before the middle, it is grey:
    black would be all of it.

    Parameters
    ----------
    intensity : array, shape (ny, nx, channels)
    options : dict
        Of `Image.to_rgb`; they are kept where they decide what is shown.
    projection : bool
        Values of a field itself, such as its maximum: signed ones are grey, as in radiology.
    """
    if options.get("colormap") is not None or options.get("mix") is not None:
        return options
    shown = mixing.chosen(options.get("channels"), intensity.shape[-1])
    if len(shown) != 1:
        return options
    if options.get("norm") is not None:
        return {**options, "colormap": "gray"}
    if (options.get("stretch", "linear"), options.get("gamut", "hue")) != ("linear", "hue"):
        return options
    if any(options.get(name) is not None for name in _DECIDING):
        return options
    if options.get("exposure") is None:
        window = _window(intensity[..., shown[0]], projection)
        if window is not None:
            return {**options, "colormap": "gray", "vmin": window[0], "vmax": window[1]}
    automatic = signed_exposure(intensity[..., shown[0]])
    if automatic is None:
        return options
    given = options.get("exposure")
    reach = 1.0 / (automatic if given is None else positive(given, "exposure"))
    # Alike on both sides.
    return {**options, "colormap": _SIGNED, "exposure": None, "vmin": -reach, "vmax": reach}


def exposure_of(intensity: NDArray[Any]) -> float:
    """Return the automatic exposure of a picture; see `Image.exposure`."""
    found = signed_exposure(intensity) if intensity.shape[-1] == 1 else None
    if found is not None:
        return found
    return automatic_exposure(mixed_channels(intensity, None, None)[1])


def signed_exposure(values: NDArray[Any]) -> float | None:
    """Return the automatic exposure of values of both signs; None if they are not."""
    known = values[np.isfinite(values)]
    least, most = (known.min(), known.max()) if known.size else (0.0, 0.0)
    if most <= 0 or -least < _SHARE * most:
        return None
    return automatic_exposure(np.abs(known))


def _window(values: NDArray[Any], projection: bool) -> tuple[float, float] | None:
    """Return which values are black and white: of negative ones, and of signed projections."""
    known = values[np.isfinite(values)]
    most = known.max() if known.size else 1.0
    if (most > 0.0 and not projection) or known.min(initial=0.0) >= -_SHARE * max(most, 0.0):
        return None
    for ends in (_WINDOW, (0.0, 100.0)):
        low, high = (float(v) for v in np.percentile(known, ends))
        if low < high:
            return low, high
    return None


def is_projection(image: Any) -> bool:
    """Return whether an image shows values of a field; see `voluminous.project`."""
    return (image.provenance or {}).get("how") in ("max", "min", "mean")
