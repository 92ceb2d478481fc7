"""Colormaps of pictures of one channel that ask for one, but name none."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import mixing

# Blue comes, red goes, and white stands still, as astronomers draw it.
_SIGNED = "RdBu_r"
# Below zero by so much of what is above, at least: less is what a sum left over.
_SHARE = 0.1
_PERCENT_WITHIN = 99.9
# Who gives one of these has said how.
_DECIDING = ("background", "exposure", "vmin", "vmax", "softening")


def with_colormap(intensity: NDArray[Any], options: dict[str, Any]) -> dict[str, Any]:
    """Return display options, with a colormap where one channel needs one and none is named.

    A norm bends the values of a colormap: then it is grey. One channel of both signs, of which
    nothing is said, has one around zero: in grey all that is negative would be black, half of a
    map of velocities.

    Parameters
    ----------
    intensity : array, shape (ny, nx, channels)
    options : dict
        Of `Image.to_rgb`; they are kept where they decide what is shown.
    """
    if options.get("colormap") is not None or options.get("mix") is not None:
        return options
    shown = mixing.chosen(options.get("channels"), intensity.shape[-1])
    if len(shown) != 1:
        return options
    if options.get("norm") is not None:
        return {**options, "colormap": "gray"}
    if options.get("stretch", "linear") != "linear":
        return options
    if any(options.get(name) is not None for name in _DECIDING):
        return options
    values = intensity[..., shown[0]]
    known = values[np.isfinite(values)]
    least, most = (known.min(), known.max()) if known.size else (0.0, 0.0)
    if most <= 0 or -least < _SHARE * most:
        return options
    # As the automatic white, and alike on both sides.
    sizes = np.abs(known[known != 0])
    reach = float(np.percentile(sizes, _PERCENT_WITHIN))
    return {**options, "colormap": _SIGNED, "vmin": -reach, "vmax": reach}
