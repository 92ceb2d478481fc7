"""What a colour bar shows: colours over a range of values, of a medium or of the intensities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UnknownNameError
from ...expressions import Expression
from ..plot import one_channel
from ..tone import display
from .lengths import pretty_unit

if TYPE_CHECKING:
    from ..image import Image

# Display options that decide which colour a channel has.
_COLORS = ("channels", "mix")
# Far beyond white: with its hue kept, a colour is then as bright as can be.
_BRIGHT = 1e6


@dataclass
class Scale:
    """A colour bar.

    Attributes
    ----------
    label : str
        What is counted, with its unit.
    norm : matplotlib.colors.Normalize
        From values to places along the bar, 0 to 1.
    colormap : matplotlib.colors.Colormap
        From places to colours.
    expr : str or None
        Expression whose values are counted beside the bar; None for the picture's own.
    unit : str
        Unit of the values.
    """

    label: str
    norm: Any
    colormap: Any
    expr: str | None = None
    unit: str = ""

    @property
    def mappable(self) -> Any:
        """What matplotlib's ``figure.colorbar`` takes."""
        from matplotlib.cm import ScalarMappable

        return ScalarMappable(norm=self.norm, cmap=self.colormap)


def of_intensity(image: Image, options: dict[str, Any]) -> Scale:
    """Return the scale of a picture that shows one channel."""
    shown = one_channel(image, **options)
    label = labelled(quantity_name(image), image.intensity_unit)
    return Scale(label, shown["norm"], shown["cmap"], unit=image.intensity_unit)


def quantity_name(image: Image) -> str:
    """Return what the intensities are: what a map was made of, or just that."""
    how = image.provenance or {}
    quantity = how.get("quantity")
    if not isinstance(quantity, str):
        return "intensity"
    kind = how.get("map", how.get("kind"))
    if kind is None:
        kind = "mean" if "weight" in how else "column"
    says = str(kind).endswith(f" of {quantity}")
    return str(kind) if says else f"{kind}, {quantity}"


def labelled(name: str, unit: str) -> str:
    """Return a name and a unit to print."""
    return f"{name} [{pretty_unit(unit)}]" if unit else name


def field_units(image: Image) -> dict[str, str]:
    """Return the units of the fields that a picture was made of, as far as it knows them."""
    told = ((image.provenance or {}).get("volume") or {}).get("fields", {})
    return {name: str(field.get("unit", "")) for name, field in told.items()}


def with_units(scale: Scale, units: Mapping[str, str]) -> str:
    """Return the label of an expression whose numbers are in the units of its fields.

    Examples
    --------
    >>> with_units(Scale("log10(density)", None, None, "log10(density)"), {"density": "g / cm3"})
    'log10(density), density in g cm⁻³'
    """
    if scale.unit or scale.expr is None:
        return scale.label
    if scale.expr in units:
        return labelled(scale.label, units[scale.expr])
    names = [name for name in Expression(scale.expr).names if units.get(name)]
    return ", ".join([scale.label, *(f"{name} in {pretty_unit(units[name])}" for name in names)])


def limits(low: float, high: float, logarithmic: bool) -> Any:
    """Return a norm over a range."""
    from matplotlib.colors import LogNorm, Normalize

    return LogNorm(low, high) if logarithmic else Normalize(low, high)


def table_colors(rows: NDArray[Any], options: dict[str, Any]) -> NDArray[Any]:
    """Return display colours of a table, its brightest as bright as can be."""
    most = float(np.abs(rows).max()) or 1.0
    return displayed(rows / most, options, 1.0)


def full_colors(rows: NDArray[Any], options: dict[str, Any]) -> NDArray[Any]:
    """Return display colours, each as bright as can be: which is which, not how bright."""
    most = np.abs(rows).max(axis=1, keepdims=True)
    return displayed(rows / np.where(most > 0, most, 1.0), options, _BRIGHT)


def displayed(rows: NDArray[Any], options: dict[str, Any], exposure: float) -> NDArray[Any]:
    """Return channels of some colours as they are seen in the picture, shape (n, 3)."""
    chosen = {name: options[name] for name in _COLORS if options.get(name) is not None}
    seen: NDArray[Any] = display(np.asarray(rows, float)[None], exposure=exposure, **chosen)[0]
    return seen


def colormap_of(name: Any) -> Any:
    """Return a colormap by its name; None if this matplotlib does not know it."""
    from ...colormaps import get_colormap

    try:
        return get_colormap(name)
    except UnknownNameError:
        return None
