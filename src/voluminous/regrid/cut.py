"""Values on a plane, and their picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..colormaps import get_colormap
from ..errors import InputError, immutable
from ..figures import add_color_bar, new_figure
from ..notebook import page, picture
from ..units import plain, unit_name
from .thumbnail import values_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .plane import Plane

_ALONG = 1 - 1e-12


@dataclass(frozen=True, repr=False)
class Slice:
    """Values on a plane.

    Attributes
    ----------
    values : array (ny, nx) or (3, ny, nx)
        Row 0 at the bottom; NaN outside the grid.
    extent : (float, float, float, float)
        left, right, bottom, top: for ``imshow(values, extent=extent, origin="lower")``.
    unit : str
        Of the values, empty if they have none.
    length_unit : str
        Of the extent.
    plane : Plane
        Where it is.
    name : str
        What is shown: a field or an expression.
    """

    values: np.ndarray
    extent: tuple[float, float, float, float]
    unit: str
    length_unit: str
    plane: Plane
    name: str = ""

    def plot(
        self,
        ax: Axes | None = None,
        *,
        colormap: Any = "viridis",
        norm: Any = None,
        vmin: Any = None,
        vmax: Any = None,
    ) -> Axes:
        """Draw the slice with axes in its unit of length, and a colour bar.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw. Default: a new figure, shown by notebooks and ``plt.show()`` if pyplot
            is in use; otherwise a figure without a window, for ``ax.figure.savefig(...)``.
        colormap : str or matplotlib.colors.Colormap
            From values to colours.
        norm : {"linear", "log"} or matplotlib.colors.Normalize, optional
            How values are spread over the colours.
        vmin, vmax : float or Quantity, optional
            Values of the first and the last colour; by default the least and the largest. Plain
            numbers are in the slice's unit.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        InputError
            If it is a slice of a vector, which has three pictures, or `norm` is none.
        UnknownNameError
            If there is no such colormap.
        UnitsError
            If a quantity cannot be converted to the slice's unit.
        """
        if self.values.ndim != 2:
            raise InputError(
                f"{self.name} is a vector, and a slice of it three pictures: slice one component, "
                "or norm(...) of it"
            )
        axes: Any = new_figure().add_subplot() if ax is None else ax
        shown = axes.imshow(
            self.values,
            origin="lower",
            extent=self.extent,
            cmap=get_colormap(colormap),
            norm=_norm(self.values, norm, *self._limits(vmin, vmax)),
            interpolation="nearest",
        )
        axes.set(xlabel=self._label(self.plane.right), ylabel=self._label(self.plane.up))
        add_color_bar(axes, shown, _with_unit(self.name, self.unit), own=ax is None)
        return axes

    def _limits(self, *limits: Any) -> list[float | None]:
        pairs = zip(("vmin", "vmax"), limits, strict=True)
        unit = self.unit or None
        return [None if v is None else float(plain(v, unit, what)) for what, v in pairs]

    def _repr_png_(self) -> bytes | None:
        return values_png([self.values]) if self.values.ndim == 2 else None

    def _repr_html_(self) -> str:
        data = self._repr_png_()
        return page("Slice", picture(data, repr(self)) if data else repr(self))

    def __repr__(self) -> str:
        ny, nx = self.values.shape[-2:]
        finite = self.values[np.isfinite(self.values)]
        span = f"{finite.min():.4g} … {finite.max():.4g}" if finite.size else "nothing"
        left, right, bottom, top = self.extent
        size = f"{right - left:.4g}×{top - bottom:.4g} {self.length_unit}".rstrip()
        what = f"{self.name}: {span} {self.unit}".rstrip()
        return f"<Slice {nx}×{ny} pixels, {size}, {what}>"

    def _label(self, way: np.ndarray) -> str:
        along = np.flatnonzero(way >= _ALONG)
        rounded = ", ".join(f"{part:.2g}" for part in way)
        return _with_unit("xyz"[along[0]] if along.size else f"({rounded})", self.length_unit)


immutable(Slice, "make another by volume.slice(...); `values` are in its `unit`")


def make_slice(
    grid: Any, plane: Plane, cells: np.ndarray, values: Any, unit: Any, name: str
) -> Slice:
    """Return values of all cells, or of three components of a vector, on a plane."""
    flat = np.asarray(values).reshape(-1, grid.size)
    shown = np.where(cells >= 0, flat[:, cells], np.nan)
    if np.asarray(values).shape == tuple(grid.shape):
        shown = shown[0]
    return Slice(shown, plane.extent, unit_name(unit), unit_name(grid.unit), plane, name)


def _norm(values: np.ndarray, norm: Any, vmin: float | None, vmax: float | None) -> Any:
    from matplotlib.colors import LogNorm, Normalize

    if isinstance(norm, Normalize):
        if vmin is not None or vmax is not None:
            raise InputError("vmin and vmax belong inside the norm that was given")
        return norm
    if norm not in (None, "linear", "log"):
        raise InputError(f"norm must be 'linear', 'log' or a matplotlib Normalize, got {norm!r}")
    if norm != "log":
        return Normalize(vmin, vmax)
    if vmin is None and not np.any(values > 0):
        raise InputError("norm='log' needs positive values, and there are none in this slice")
    return LogNorm(vmin, vmax)


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
