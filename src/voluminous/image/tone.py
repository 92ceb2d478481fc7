"""Tone mapping, from intensities to display values: mix, exposure, stretch and gamut."""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Iterable
from copy import copy
from functools import reduce
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..colormaps import get_color, get_colormap, opaque_color, without_alpha
from ..errors import InputError, check_name
from ..units import as_quantity, is_listed, is_quantity, plain

if TYPE_CHECKING:
    from matplotlib.colors import Normalize

    from .image import Image

Pixels = NDArray[np.float32]

GAMUTS = ("hue", "clip")
GAMMA = 2.2  # the usual approximation of the display encoding
# The smallest value of a logarithmic scale, in units of the largest.
_DECADES = 1e-6
# Replace infinity before and after scaling, so that ratios of colours stay finite.
_LARGE, _HUGE = 1e150, 1e30
_FAINTEST = float(np.finfo(np.float64).tiny)
_PERCENT_BELOW_WHITE = 99.9
# Maps of velocities, and astronomers' colours of them: blue approaches, red recedes.
_VELOCITIES = ("velocity", "mean velocity")
_SIGNED = "RdBu_r"
# Minimum ratio of the negative to the positive range; below it, negative values are rounding.
_SHARE = 0.1
# Percentiles of a projection's values that are shown as black and white.
_WINDOW = (0.5, 99.8)
# Orange and blue for two channels: distinguishable with any kind of colour vision, and their sum
# is nearly white.
_TWO = ((1.0, 0.6, 0.2), (0.1, 0.4, 1.0))
_NOT_BOTH = "give {} or {}, not both: they set the same thing"


class Curve(NamedTuple):
    """An increasing function of [0, 1] onto itself, and its inverse."""

    forward: Callable[[Any], Any]
    inverse: Callable[[Any], Any]


def _power(gamma: float) -> Curve:
    return Curve(lambda v: v ** (1 / gamma), lambda w: w**gamma)


LINEAR = Curve(lambda v: v, lambda w: w)
_FIXED = {"linear": LINEAR, "sqrt": Curve(np.sqrt, np.square), "gamma": _power(GAMMA)}
# A function of v / softening, its inverse, and the default softening.
_SOFT = {"asinh": (np.arcsinh, np.sinh, 0.1), "log": (np.log1p, np.expm1, 0.01)}
STRETCHES = (*_FIXED, *_SOFT)


def curve(stretch: str | float, softening: float | None = None) -> Curve:
    """Return the curve of a named stretch, or v**(1/g) for a number g.

    `softening` is the end of the linear part of "asinh" and "log", in units of white.
    """
    if softening is not None and stretch not in tuple(_SOFT):
        raise InputError(f"softening is for the stretches {' and '.join(_SOFT)}, not {stretch!r}")
    if not isinstance(stretch, str):
        return _power(positive(stretch, "stretch"))
    check_name("stretch", stretch, STRETCHES)
    if stretch in _FIXED:
        return _FIXED[stretch]
    bend, straighten, default = _SOFT[stretch]
    soft = default if softening is None else positive(softening, "softening")
    top = bend(1 / soft).item()
    return Curve(lambda v: bend(v / soft) / top, lambda w: soft * straighten(w * top))


def positive(value: Any, what: str) -> float:
    """Return `value` as a float; raise unless it is positive and finite."""
    number = finite(value, what)
    if number <= 0:
        raise InputError(f"{what} must be greater than 0, got {value!r}")
    return number


def finite(value: Any, what: str) -> float:
    """Return `value` as a float; raise unless it is finite."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{what} must be a number, got {value!r}") from None
    if not np.isfinite(number):
        raise InputError(f"{what} must be finite, got {value!r}")
    return number


def _top(exposure: Any, vmax: Any) -> float | None:
    if exposure is not None and vmax is not None:
        raise InputError(_NOT_BOTH.format("exposure", "vmax"))
    if exposure is not None:
        return 1.0 / positive(exposure, "exposure")
    return None if vmax is None else finite(vmax, "vmax")


def scale(
    values: NDArray[Any], bend: Curve, norm: Any, exposure: Any, vmin: Any, vmax: Any
) -> Normalize:
    """Return the matplotlib norm that maps the intensities of one channel to 0 … 1.

    `norm` replaces the stretch `bend`; `exposure` means vmax = 1 / exposure; the finite values set
    the limits that are None.
    """
    from matplotlib.colors import FuncNorm, LogNorm, Normalize

    if norm is not None and bend is not LINEAR:
        raise InputError(_NOT_BOTH.format("norm", "stretch"))
    top = _top(exposure, vmax)
    if isinstance(norm, Normalize):
        if vmin is not None or top is not None:
            raise InputError("vmin, vmax and exposure belong inside the norm that was given")
        copied: Normalize = copy(norm)  # do not change the caller's object
        copied.autoscale_None(values[np.isfinite(values)])
        return copied
    if not (norm is None or (isinstance(norm, str) and norm in ("linear", "log"))):
        raise InputError(f"norm must be 'linear', 'log' or a matplotlib Normalize, got {norm!r}")
    log = norm == "log"
    shown = values[np.isfinite(values) & (values > 0 if log else True)]
    high = top if top is not None else float(shown.max()) if shown.size else 1.0
    if vmin is not None:
        low = finite(vmin, "vmin")
    else:
        low = float(shown.min()) if shown.size else 0.0
        low = max(low, _DECADES * high) if log else low
    if low > high or (log and low <= 0):
        raise InputError(f"vmin ({low:g}) must be {'positive and ' * log}less than vmax ({high:g})")
    if log:
        return LogNorm(low, high, clip=True)
    if bend is LINEAR or low == high:
        return Normalize(low, high)
    span = high - low

    def forward(values: Any) -> Any:
        return bend.forward(np.maximum((np.asarray(values) - low) / span, 0))

    def inverse(shown: Any) -> Any:
        return low + span * bend.inverse(np.asarray(shown))

    return FuncNorm((forward, inverse), low, high)


_NAMES = "exposure stretch gamut channels mix colormap norm vmin vmax background softening"
OPTIONS = frozenset(_NAMES.split())


def display(
    intensity: NDArray[Any], transparency: NDArray[Any] | None, options: dict[str, Any]
) -> Pixels:
    """Return display values from 0 to 1, shape (ny, nx, 3); see `Image.to_rgb`."""
    get = options.get
    exposure, vmin, vmax, norm = get("exposure"), get("vmin"), get("vmax"), get("norm")
    channels, mix, background = get("channels"), get("mix"), get("background")
    bend, colormap = curve(get("stretch", "linear"), get("softening")), get("colormap")
    if colormap is None:
        if norm is not None:
            raise InputError(
                "norm belongs to a colormap, which shows one channel: give channels=0 or another, "
                "or use stretch"
            )
        mixed, brightest = mixed_channels(intensity, channels, mix)
        black = 0.0 if vmin is None else finite(vmin, "vmin")
        mixed -= black
        mixed /= white_level(brightest, exposure, black, vmax) - black
        linear = np.clip(mixed, 0.0, _HUGE).astype(np.float32)
        rgb = _in_gamut(linear, bend, get("gamut", "hue"))
    else:
        if mix is not None:
            raise InputError("a colormap shows one channel, so it cannot be used together with mix")
        values = intensity[..., _single(channels, intensity.shape[-1])].astype(np.float64)
        limits = scale(values, bend, norm, exposure, vmin, vmax)
        # Norms mask infinities; clipping them to the ends of the scale keeps them visible.
        ends = np.nan_to_num(values, nan=np.nan, posinf=limits.vmax, neginf=limits.vmin)
        rgba = get_colormap(colormap)(limits(ends))
        rgb = (rgba[..., :3] * rgba[..., 3:]).astype(np.float32)  # transparent ones over black
    if background is None:
        return rgb
    if transparency is None:
        raise InputError("background needs an image whose transparency is known")
    color = np.array(opaque_color(background, "background"), dtype=np.float32)
    through = np.nan_to_num(transparency.mean(axis=-1, keepdims=True, dtype=np.float64))
    in_front: Pixels = np.minimum(rgb + through.astype(np.float32) * color, 1)
    return in_front


def mixed_channels(
    intensity: NDArray[Any], channels: Any, mix: Any
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return RGB (ny, nx, 3) and the maximum over the colours of each finite pixel (n,)."""
    indices = chosen(channels, intensity.shape[-1])
    colors = _matrix(mix, len(indices))
    shown = intensity if channels is None else intensity[..., indices]
    mixed = shown.astype(np.float64)
    # Infinity times a zero matrix element is NaN; a large number times zero is zero.
    np.nan_to_num(mixed, copy=False, nan=0.0, posinf=_LARGE, neginf=0.0)
    if not np.array_equal(colors, np.eye(3)):
        mixed = mixed @ colors
    return mixed, _brightest(mixed)[np.isfinite(_brightest(shown))]


def _brightest(colors: NDArray[Any]) -> Any:
    # Many times faster than max(axis=-1), which loops over the channels of each pixel.
    return reduce(np.maximum, np.moveaxis(colors, -1, 0))


def white_level(brightest: NDArray[Any], exposure: Any, black: float, vmax: Any) -> float:
    """Return the intensity shown as white: `vmax`, 1 / `exposure`, or the automatic level."""
    white = _top(exposure, vmax)
    if white is None:
        white = 1.0 / automatic_exposure(brightest)
        return white if white > black else black + 1.0
    if white <= black:
        raise InputError(f"white (vmax or 1 / exposure: {white:g}) must be above vmin ({black:g})")
    return white


def automatic_exposure(brightest: NDArray[Any]) -> float:
    """Return 1 / w, where w is the 99.9 % percentile of the pixels above zero; 1 if there are none.

    Black pixels do not count, so that a small object in front of black is exposed like a large
    one; 0.1 % may be overexposed, so that a star does not darken the rest.
    """
    lit = brightest[brightest > 0]
    if lit.size == 0:
        return 1.0
    white = float(np.percentile(lit, _PERCENT_BELOW_WHITE))
    return 1.0 / min(max(white, _FAINTEST), 1.0 / _FAINTEST)


def _in_gamut(linear: Pixels, bend: Curve, gamut: str) -> Pixels:
    """Stretch non-negative linear colours and map them into the gamut 0 … 1."""
    check_name("gamut", gamut, GAMUTS)
    if gamut == "clip":
        clipped: Pixels = bend.forward(np.minimum(linear, 1))
        return clipped
    brightest = _brightest(linear)[..., None]
    divisor = np.where(brightest > 0, brightest, 1)
    # Dividing first avoids overflow for numbers near the limits of float32.
    rgb: Pixels = np.minimum(linear / divisor * bend.forward(np.minimum(brightest, 1)), 1)
    return rgb


def with_colormap(image: Image, options: dict[str, Any]) -> dict[str, Any]:
    """Return display options as plain numbers, with a colormap if one channel needs one.

    A norm without a colormap uses grey. One channel of both signs, without explicit options, gets
    a diverging colormap around zero, because grey would show all negative values (half of a map
    of velocities) as black. A channel without positive values, such as depths in front of the
    middle, gets a grey colormap, because it would be entirely black otherwise; so do signed values
    of a field, such as its maximum, as in radiology. Velocities of one sign, of what recedes as a
    whole, get a diverging colormap around their middle; so do velocities between limits.
    """
    options = plain_options(options, image.intensity_unit)
    given = {name for name, value in options.items() if value is not None}
    shown = chosen(options.get("channels"), image.channels)
    if given & {"colormap", "mix"} or len(shown) != 1:
        return options
    if "norm" in given:
        return {**options, "colormap": "gray"}
    look = options.get("stretch", "linear"), options.get("gamut", "hue")
    how = image.provenance or {}
    if how.get("map") in _VELOCITIES and {"vmin", "vmax"} <= given:
        return {**options, "colormap": _SIGNED}
    usual = all(isinstance(name, str) for name in look) and look == ("linear", "hue")
    if not usual or given & {"background", "vmin", "vmax", "softening"}:
        return options
    values = image.intensity[..., shown[0]]
    if "exposure" not in given:
        colormap, window = "gray", _window(values, how.get("how") in ("max", "min", "mean"))
        if how.get("map") in _VELOCITIES and signed_exposure(values) is None:
            colormap, window = _SIGNED, _ends(values[np.isfinite(values)])
        if window is not None:
            return {**options, "colormap": colormap, "vmin": window[0], "vmax": window[1]}
    automatic = signed_exposure(values)
    if automatic is None:
        return options
    reach = _top(options.get("exposure"), None) or 1.0 / automatic
    # Limits symmetric around zero.
    return {**options, "colormap": _SIGNED, "exposure": None, "vmin": -reach, "vmax": reach}


def exposure_of(intensity: NDArray[Any]) -> float:
    """Return the automatic exposure of a picture; see `Image.exposure`."""
    signed = signed_exposure(intensity) if intensity.shape[-1] == 1 else None
    if signed is not None:
        return signed
    return automatic_exposure(mixed_channels(intensity, None, None)[1])


def signed_exposure(values: NDArray[Any]) -> float | None:
    """Return the automatic exposure of |values|; None unless both signs are significant."""
    valid = values[np.isfinite(values)]
    least, most = (valid.min(), valid.max()) if valid.size else (0.0, 0.0)
    if most <= 0 or -least < _SHARE * most:
        return None
    return automatic_exposure(np.abs(valid))


def _window(values: NDArray[Any], projection: bool) -> tuple[float, float] | None:
    valid = values[np.isfinite(values)]
    most = valid.max() if valid.size else 1.0
    if (most > 0.0 and not projection) or valid.min(initial=0.0) >= -_SHARE * max(most, 0.0):
        return None
    return _ends(valid)


def _ends(valid: NDArray[Any]) -> tuple[float, float] | None:
    """Return percentiles near both ends; the ends if these are equal, None if all are."""
    for ends in (_WINDOW, (0.0, 100.0)) if valid.size else ():
        low, high = (float(v) for v in np.percentile(valid, ends))
        if low < high:
            return low, high
    return None


def chosen(channels: Any, count: int) -> list[int]:
    """Return the indices of the channels to show, out of `count`."""
    if channels is None:
        return list(range(count))
    try:
        indices = [operator.index(c) for c in np.atleast_1d(np.asarray(channels))]
    except (TypeError, ValueError):
        indices = []
    if not indices or min(indices) < 0 or max(indices) >= count:
        raise InputError(
            f"channels must be integers from 0 to {count - 1}, as the image has {count} "
            f"channel{'s' * (count > 1)}; got {channels!r}"
        )
    return indices


def _single(channels: Any, count: int) -> int:
    index, *others = chosen(channels, count)
    if others:
        raise InputError(
            f"a colormap shows one channel, not {1 + len(others)}: choose one with channels=0 … "
            f"{count - 1}"
        )
    return index


def _matrix(mix: Any, count: int) -> NDArray[np.float64]:
    """Return the RGB weights of `count` channels, shape (count, 3)."""
    if mix is None:
        if count == 2:
            return np.array(_TWO)
        # One channel is grey, three are red, green and blue, and every further one is white.
        primary = np.eye(3)[: 3 * (count > 2)]
        return np.vstack([primary, np.ones((count - len(primary), 3))])
    if is_listed(mix):
        mix = [get_color(c) if isinstance(c, str) else without_alpha(c, "mix") for c in mix]
    try:
        colors = np.array(mix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"mix must be numbers, a row (r, g, b) per channel; got {mix!r}") from None
    if colors.shape != (count, 3) or not np.isfinite(colors).all():
        raise InputError(
            f"mix must have shape ({count}, 3) and be finite: a row (r, g, b) for each channel "
            f"that is shown; got shape {colors.shape}"
        )
    return colors


def check_options(kind: str, given: Iterable[str], known: Collection[str]) -> None:
    """Raise for the first option whose name is not in `known`."""
    for name in given:
        check_name(kind, name, known)


def plain_options(options: dict[str, Any], unit: str) -> dict[str, Any]:
    """Return display options with exposure and limits as plain numbers, in the displayed unit."""
    exposure = options.get("exposure")
    if isinstance(exposure, str):
        if exposure != "rgb":
            raise InputError(
                f"exposure must be a number, or 'rgb' for intensities as they are, got {exposure!r}"
            )
        changing = ("stretch", "softening", "colormap", "norm", "vmin", "vmax")
        if others := [n for n in changing if options.get(n) not in (None, "linear")]:
            raise InputError(
                f"exposure='rgb' shows intensities as they are; leave out {' and '.join(others)}, "
                "or give exposure=1"
            )
        options = options | {"exposure": 1.0, "gamut": "clip"}
    limits = {name: options.get(name) for name in ("vmin", "vmax")}
    return options | {
        name: float(plain(value, unit or None, name))
        for name, value in limits.items()
        if is_quantity(as_quantity(value))
    }


def display_values(image: Image, transparent: bool, options: dict[str, Any], bits: int) -> Any:
    """Return display values as whole numbers of 8 or 16 bits, (ny, nx, 3), or 4 with alpha.

    Alpha is straight (not premultiplied): the picture looks as before in front of black.
    """
    rgb = image.to_rgb(**options)
    if transparent:
        if image.transparency is None:
            raise InputError("transparent=True needs an image whose transparency is known")
        through = np.clip(np.nan_to_num(image.transparency.mean(axis=-1, keepdims=True)), 0, 1)
        alpha = np.maximum(1 - through, rgb.max(axis=-1, keepdims=True))
        rgb = np.concatenate([rgb / np.where(alpha > 0, alpha, 1), alpha], axis=-1)
    return np.rint(rgb * np.float32(2**bits - 1)).astype(f"uint{bits}")


def over_black(samples: NDArray[Any], *, multiplied: bool = False) -> dict[str, NDArray[Any]]:
    """Return intensity and transparency of samples whose last one is alpha.

    `multiplied` says that the colours are multiplied with alpha already.
    """
    full = np.iinfo(samples.dtype).max if samples.dtype.kind in "iu" else 1.0
    colors, alpha = samples[..., :-1], samples[..., -1:] / full
    return {"intensity": colors if multiplied else colors * alpha, "transparency": 1 - alpha}


def shows_one_channel(image: Image, options: dict[str, Any]) -> bool:
    """Return True if display options show one channel, in grey or through a colormap."""
    if options.get("mix") is not None or options.get("background") is not None:
        return False
    return options.get("colormap") is not None or (
        len(chosen(options.get("channels"), image.channels)) == 1
    )


def one_channel(image: Image, **options: Any) -> dict[str, Any]:
    """Return the arguments of imshow for one channel, so that a colour bar can be added."""
    options = with_colormap(image, options)
    values = image.intensity[..., _single(options.get("channels"), image.channels)]
    bend = curve(options.get("stretch", "linear"), options.get("softening"))
    exposure, vmin, vmax, colormap = (
        options.get(name) for name in ("exposure", "vmin", "vmax", "colormap")
    )
    if colormap is None:  # the limits of `to_rgb`: from 0 to white
        vmin = 0.0 if vmin is None else finite(vmin, "vmin")
        vmax = white_level(values[np.isfinite(values)], exposure, vmin, vmax)
        exposure, colormap = None, "gray"
    norm = scale(values, bend, options.get("norm"), exposure, vmin, vmax)
    return {"X": values, "norm": norm, "cmap": get_colormap(colormap)}


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
