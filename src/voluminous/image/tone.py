"""From intensities to display values: choose, mix, expose, stretch, fit into the gamut."""

from __future__ import annotations

import inspect
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..colormaps import opaque_color
from ..errors import InputError, unknown_name
from . import mixing
from .colormap import mapped, scale
from .stretch import Curve, curve, finite, positive

# Stand for infinity before and after scaling: ratios of colours can still be formed with them.
_LARGE = 1e150
_HUGE = 1e30
_PERCENT_BELOW_WHITE = 99.9
_FAINTEST = float(np.finfo(np.float64).tiny)
GAMUTS = ("hue", "clip")


def display(
    intensity: NDArray[Any],
    transparency: NDArray[Any] | None = None,
    *,
    exposure: float | None = None,
    stretch: str | float = "linear",
    gamut: str = "hue",
    channels: Any = None,
    mix: Any = None,
    colormap: Any = None,
    norm: Any = None,
    vmin: float | None = None,
    vmax: float | None = None,
    background: Any = None,
    softening: float | None = None,
) -> NDArray[np.float32]:
    """Return display values from 0 to 1, shape (ny, nx, 3); see `Image.to_rgb`."""
    bend = curve(stretch, softening)
    if colormap is None:
        if norm is not None:
            raise InputError(
                "norm belongs to a colormap, which shows one channel: give channels=0 or another, "
                "or use stretch"
            )
        linear = _exposed(intensity, channels, mix, exposure, vmin, vmax)
        rgb = fit(linear, bend, gamut)
    else:
        if mix is not None:
            raise InputError("a colormap shows one channel, so it cannot be used together with mix")
        values = intensity[..., mixing.single(channels, intensity.shape[-1], "a colormap")]
        rgb = mapped(values, colormap, scale(values, bend, norm, exposure, vmin, vmax))
    return rgb if background is None else _in_front(rgb, transparency, background)


OPTIONS = frozenset(inspect.signature(display).parameters) - {"intensity", "transparency"}


def _exposed(
    intensity: NDArray[Any], channels: Any, mix: Any, exposure: Any, vmin: Any, vmax: Any
) -> NDArray[np.float32]:
    """Mix the channels and scale so that black is 0 and white is 1; still beyond the gamut."""
    mixed, brightest = mixed_channels(intensity, channels, mix)
    black = 0.0 if vmin is None else finite(vmin, "vmin")
    white = white_level(brightest, exposure, black, vmax)
    mixed -= black
    mixed /= white - black
    np.clip(mixed, 0.0, _HUGE, out=mixed)
    return mixed.astype(np.float32)


def mixed_channels(
    intensity: NDArray[Any], channels: Any, mix: Any
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return red, green and blue (ny, nx, 3), and their brightest where finite (n,)."""
    indices = mixing.chosen(channels, intensity.shape[-1])
    colors = mixing.matrix(mix, len(indices))
    shown = intensity if channels is None else intensity[..., indices]
    mixed = shown.astype(np.float64)
    # Infinity times a zero of the matrix would be NaN; a large number times zero is zero.
    np.nan_to_num(mixed, copy=False, nan=0.0, posinf=_LARGE, neginf=0.0)
    if not np.array_equal(colors, np.eye(3)):
        mixed = mixed @ colors
    return mixed, _brightest(mixed)[np.isfinite(_brightest(shown))]


def _brightest(colors: NDArray[Any]) -> NDArray[Any]:
    # Many times faster than max(axis=-1), which takes the few channels pixel by pixel.
    return reduce(np.maximum, np.moveaxis(colors, -1, 0))


def white_level(brightest: NDArray[Any], exposure: Any, black: float, vmax: Any) -> float:
    """Return the intensity shown as white: `vmax`, or 1 / `exposure`, or the automatic one.

    Raises
    ------
    InputError
        If both are given, or white is not above black.
    """
    if exposure is not None and vmax is not None:
        raise InputError("give exposure or vmax, not both: they set the same thing")
    if exposure is None and vmax is None:
        white = 1.0 / automatic_exposure(brightest)
        return white if white > black else black + 1.0
    white = finite(vmax, "vmax") if exposure is None else 1.0 / positive(exposure, "exposure")
    if white <= black:
        raise InputError(f"white (vmax or 1 / exposure: {white:g}) must be above vmin ({black:g})")
    return white


def automatic_exposure(brightest: NDArray[Any]) -> float:
    """Return 1 / w, where 99.9 % of the lit pixels stay below w.

    Pixels are lit that are above zero, so a small object in front of black is exposed like a large
    one; one in a thousand may be overexposed, so a star does not darken all else.

    Parameters
    ----------
    brightest : array
        The brightest of the colours of each pixel, finite; 1 is returned if all are black.
    """
    lit = brightest[brightest > 0]
    if lit.size == 0:
        return 1.0
    white = float(np.percentile(lit, _PERCENT_BELOW_WHITE))
    return 1.0 / min(max(white, _FAINTEST), 1.0 / _FAINTEST)


def fit(linear: NDArray[np.float32], bend: Curve, gamut: str) -> NDArray[np.float32]:
    """Stretch non-negative linear colours and fit them into 0 … 1.

    Raises
    ------
    UnknownNameError
        If there is no such gamut rule.
    """
    if gamut == "clip":
        return bend.forward(np.minimum(linear, 1))
    if gamut != "hue":
        raise unknown_name("gamut", str(gamut), GAMUTS)
    brightest = _brightest(linear)[..., None]
    divisor = np.where(brightest > 0, brightest, 1)
    # Dividing first keeps ratios of numbers near the ends of float32 inside its range.
    return np.minimum(linear / divisor * bend.forward(np.minimum(brightest, 1)), 1)


def _in_front(
    rgb: NDArray[np.float32], transparency: NDArray[Any] | None, background: Any
) -> NDArray[np.float32]:
    if transparency is None:
        raise InputError("background needs an image whose transparency is known")
    color = np.array(opaque_color(background, "background"), dtype=np.float32)
    through = np.nan_to_num(transparency.mean(axis=-1, keepdims=True, dtype=np.float64))
    return np.minimum(rgb + through.astype(np.float32) * color, 1)
