"""One channel through a matplotlib colormap."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..colormaps import get_colormap
from ..errors import InputError
from .stretch import LINEAR, Curve, finite, positive

if TYPE_CHECKING:
    from matplotlib.colors import Normalize

_DECADES = 1e-6


def scale(
    values: NDArray[Any], bend: Curve, norm: Any, exposure: Any, vmin: Any, vmax: Any
) -> Normalize:
    """Return the matplotlib norm that takes intensities to 0 … 1.

    Parameters
    ----------
    values : array
        One channel; its finite values give the limits that are not given.
    bend : Curve
        The stretch, used if `norm` is None.
    norm : {"linear", "log"}, Normalize or None
        Given in place of a stretch.
    exposure, vmin, vmax : float or None
        Limits; `exposure` stands for vmax = 1 / exposure.

    Raises
    ------
    InputError
        If they contradict each other.
    """
    from matplotlib.colors import LogNorm, Normalize

    if norm is not None and bend is not LINEAR:
        raise InputError("give norm or stretch, not both: they set the same thing")
    vmax = _highest(exposure, vmax)
    if isinstance(norm, Normalize):
        return _filled(norm, values, vmin, vmax)
    if norm not in (None, "linear", "log"):
        raise InputError(f"norm must be 'linear', 'log' or a matplotlib Normalize, got {norm!r}")
    low, high = _limits(values, vmin, vmax, logarithmic=norm == "log")
    if norm == "log":
        return LogNorm(low, high, clip=True)
    if bend is LINEAR or low == high:
        return Normalize(low, high)
    return _bent(bend, low, high)


def _highest(exposure: Any, vmax: Any) -> Any:
    if exposure is None:
        return vmax
    if vmax is not None:
        raise InputError("give exposure or vmax, not both: they set the same thing")
    return 1.0 / positive(exposure, "exposure")


def _bent(bend: Curve, low: float, high: float) -> Normalize:
    from matplotlib.colors import FuncNorm

    span = high - low

    def forward(values: Any) -> Any:
        return bend.forward(np.maximum((np.asarray(values) - low) / span, 0))

    def inverse(shown: Any) -> Any:
        return low + span * bend.inverse(np.asarray(shown))

    return FuncNorm((forward, inverse), low, high)


def _filled(norm: Normalize, values: NDArray[Any], vmin: Any, vmax: Any) -> Normalize:
    from copy import copy

    if vmin is not None or vmax is not None:
        raise InputError("vmin, vmax and exposure belong inside the norm that was given")
    own = copy(norm)  # the limits found here must not stick to the caller's object
    own.autoscale_None(values[np.isfinite(values)])
    return own


def _limits(
    values: NDArray[Any], vmin: Any, vmax: Any, *, logarithmic: bool
) -> tuple[float, float]:
    shown = values[np.isfinite(values) & (values > 0 if logarithmic else True)]
    high = finite(vmax, "vmax") if vmax is not None else float(shown.max()) if shown.size else 1.0
    if vmin is not None:
        low = finite(vmin, "vmin")
    else:
        low = float(shown.min()) if shown.size else high * (_DECADES if logarithmic else 0)
        low = max(low, _DECADES * high) if logarithmic else low
    if low > high or (logarithmic and low <= 0):
        raise InputError(
            f"vmin ({low:g}) must be {'positive and ' * logarithmic}less than vmax ({high:g})"
        )
    return low, high


def mapped(values: NDArray[Any], colormap: Any, norm: Normalize) -> NDArray[np.float32]:
    """Return the colours of a channel, shape (ny, nx, 3); transparent ones over black."""
    table = get_colormap(colormap)
    assert norm.vmin is not None
    assert norm.vmax is not None
    # Norms mask infinities; the ends of the scale show them as what they are.
    # In double precision differences of numbers near the end of float32 are numbers.
    wide = values.astype(np.float64)
    ends = np.nan_to_num(wide, copy=False, nan=np.nan, posinf=norm.vmax, neginf=norm.vmin)
    rgba = table(norm(ends))
    return (rgba[..., :3] * rgba[..., 3:]).astype(np.float32)
