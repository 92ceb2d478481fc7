"""How often values occur: beside a colour bar."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...expressions import Expression
from ...units import parse_unit

if TYPE_CHECKING:
    from ..image import Image
    from .scales import Scale

# So many cells tell a histogram; more are looked at in so many pieces, evenly spread.
_CELLS, _PIECES = 1 << 20, 128
_BINS = 60
# All but a few values: one odd cell is no range.
_LEAST, _GREATEST = 0.1, 99.9


class FieldValues:
    """Values of expressions in a volume, or in a part of it that stands for the whole."""

    def __init__(self, volume: Any) -> None:
        self.volume = volume
        self._found: dict[str, NDArray[Any]] = {}

    def values(self, text: str, unit: str) -> NDArray[Any]:
        """Return finite values in a unit; in the fields' own, if none is given."""
        if text not in self._found:
            self._found[text] = self._sampled(Expression(text))
        own, wanted = self.volume.expression_unit(Expression(text)), parse_unit(unit)
        same = own is None or wanted is None
        found = self._found[text]
        return found if same else np.asarray(own.to(wanted, found))  # dex are shifted, not scaled

    def span(self, text: str, unit: str) -> tuple[float, float] | None:
        """Return the range of nearly all values; None if there are none."""
        values = self.values(text, unit)
        if values.size == 0:
            return None
        low, high = np.percentile(values, (_LEAST, _GREATEST))
        return float(low), float(high)

    def _sampled(self, expression: Expression) -> NDArray[Any]:
        self.volume.check_names(expression)
        size = self.volume.grid.size
        count = _PIECES if size > _CELLS else 1
        length = min(size, _CELLS) // count
        starts = np.linspace(0, size - length, count).astype(int)
        found = [self.volume.evaluate_cells(expression, s, s + length) for s in starts.tolist()]
        values = np.concatenate(found).astype(float)
        return values[np.isfinite(values)]


def counts(scale: Scale, image: Image, fields: FieldValues | None, channel: int) -> Any:
    """Return counts in bins along a colour bar, from 0 to 1 on a logarithmic scale.

    None where the values are not known.
    """
    if scale.expr is None:
        values = image.intensity[..., channel].ravel()
        values = values[np.isfinite(values)]
    elif fields is None:
        return None
    else:
        values = fields.values(scale.expr, scale.unit)
    places: NDArray[Any] = np.ma.filled(np.ma.asarray(scale.norm(values), dtype=float), np.nan)
    found, _ = np.histogram(places, _BINS, (0.0, 1.0))
    if not found.any():
        return None
    # A field has most of its cells in few bins, and what is shown in others.
    return np.log1p(found) / np.log1p(found.max())
