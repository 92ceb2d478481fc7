"""Colours from a matplotlib colormap, as a medium."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..backend.types import Mask
from ..errors import InputError
from ..expressions.interval import Interval
from .arguments import check_plain
from .bound import Binding, BoundMedium
from .color_by import SAMPLES, ColorScale
from .context import Context, MediumSample
from .contract import Medium
from .table import Table


class Colormap(Table):
    """Colours from a matplotlib colormap, opacity uniform or as a function of the position in it.

    Parameters
    ----------
    expr : str
        Expression x of the fields.
    cmap : str or matplotlib.colors.Colormap
        Name or object; its RGB become three channels.
    vmin, vmax : float or Quantity, optional
        Range of x; beyond it the colours of the ends go on. What is not given is measured when a
        volume is drawn, as in `calibrated`: so that 99 % of the volume is between.
    opacity : float, callable or array_like, shape (samples,), default 1
        Extinction h_α, or a function of the position 0 … 1 in the colormap, or what it gives for
        each of the entries.
    path_length : float, Quantity or "auto", default "auto"
        Length to which colour and opacity refer: seen through one path length, a value shows the
        colour of the map times `opacity` (emission weighted by opacity, as in a picture).
        ``"auto"`` as in `Table`.
    where, shading, lights
        As in `Gaussian`.
    norm : str or matplotlib.colors.Normalize, optional
        How x maps to the position: ``"linear"``, ``"log"``, ``"symlog"`` … or an object.
    samples : int
        Number of entries taken from the map.

    Raises
    ------
    UnknownNameError
        If there is no such colormap or norm.
    InputError
        If the range is empty, or the norm cannot be applied to it.
    """

    def __init__(
        self,
        expr: Any,
        cmap: Any,
        vmin: Any = None,
        vmax: Any = None,
        opacity: Any = 1.0,
        path_length: Any = "auto",
        *,
        norm: Any = None,
        samples: int = SAMPLES,
        where: Any = None,
        shading: float = 0.0,
        lights: Any = None,
    ) -> None:
        self.range = scale = ColorScale(cmap, vmin, vmax, norm, samples)
        alpha = _opacities(opacity, scale.position)
        self._opacity = alpha.tolist() if np.ndim(opacity) or callable(opacity) else float(alpha[0])
        super().__init__(
            expr,
            scale.values if scale.unit is None else scale.values * scale.unit,
            scale.rows * alpha[:, None],
            alpha,
            path_length,
            where=where,
            shading=shading,
            lights=lights,
        )

    def _scale(self) -> ColorScale:
        return self.range

    def visible_key(self) -> Any:
        return self.modulation.gate_key() if self.range.is_open else super().visible_key()

    def bind(self, binding: Binding) -> BoundMedium:
        return _Open(self, binding) if self.range.is_open else super().bind(binding)

    def describe(self) -> dict[str, Any]:
        return {**Medium.describe(self), **self.range.describe(), "opacity": self._opacity}


class _Open(BoundMedium):
    """A colormap before it has a range: it may show where the gate may be open."""

    def __init__(self, medium: Colormap, binding: Binding) -> None:
        self._range, self._modulation = medium.range, medium.modulation.bind(binding)

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        self._range.measured()
        raise AssertionError

    def may_show(self, ranges: dict[str, Interval], context: Context) -> Mask:
        return self._modulation.may_show(ranges, context)


# More numbers are not shown in an error.
_FEW = 8


def _opacities(opacity: Any, position: np.ndarray) -> np.ndarray:
    """Return the opacity at positions in a colormap: from a number, a function, or one for each."""
    check_plain(opacity, "opacity")
    given = [opacity(float(p)) for p in position] if callable(opacity) else opacity
    try:
        alpha = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"opacity must be a number or a function, got {opacity!r}") from error
    if alpha.shape not in ((), position.shape):
        raise InputError(
            "opacity must be one number, or a function that gives one, or a list of "
            f"{len(position)}, one for each sample; got "
            + (repr(opacity) if alpha.size < _FEW else f"an array of shape {alpha.shape}")
        )
    return np.broadcast_to(alpha, position.shape)
