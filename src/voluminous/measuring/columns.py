"""Columns: the integral of a quantity along every line of sight, or its weighted mean."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..expressions import product
from ..progress import Progress, with_progress
from .integrals import integrals
from .maps import as_map
from .quantity import Quantity, check_volume, column_unit, converted

if TYPE_CHECKING:
    from ..image import Image


@with_progress
def column(
    volume: Any,
    quantity: Any,
    camera: Any,
    *,
    weight: Any = None,
    method: str = "rays",
    samples: int = 1,
    unit: Any = None,
    precision: str = "single",
    device: str = "auto",
    progress: Progress = None,
) -> Image:
    """Return a map of ∫ q ds, or of ∫ q w ds / ∫ w ds, along the lines of sight.

    A quantity is constant in a cell. Where it is missing (NaN), or an expression has no value, it
    counts nothing.

    Parameters
    ----------
    volume : Volume
        Grid and fields.
    quantity : str or Expression
        A field or an expression, of either sign; ``los("velocity")`` is the velocity away from the
        observer.
    camera : Orthographic or Perspective
        The lines of sight, and the pixels.
    weight : str or Expression, optional
        Return the mean of the quantity with this weight; NaN where the weight is zero.
    method : {"rays", "exact"}
        Rays through the pixels' centres (or parts of them, see `samples`); or the mean over the
        area of each pixel, from the shadows of all cells in closed form: the sum of all pixels
        times their area is that of the cells times their volumes to rounding, from any direction
        and with pixels of any size. Exact maps take an orthographic camera, and cells that are
        boxes.
    samples : int
        For rays: n for n × n rays per pixel, which converge to the exact mean.
    unit : str or unit, optional
        Of the map; by default that of the quantity times the length unit it is made of: g / cm2 for
        g / cm3, whatever the unit of the volume's lengths.
    precision, device, progress
        As for `render`; for rays.

    Returns
    -------
    Image
        One channel, shape (ny, nx, 1).

    Raises
    ------
    UnknownNameError
        For a field or method that does not exist.
    InputError
        If the exact method cannot be used, or the quantity is infinite in a cell.
    UnitsError
        If the map is not of the unit.
    """
    how: dict[str, Any] = {
        "method": method,
        "samples": samples,
        "precision": precision,
        "device": device,
        "progress": progress,
    }
    check_volume(volume)
    what = Quantity.of(volume.seen_by(camera), quantity)
    told = {"quantity": what.text, "method": method, "samples": samples}
    told["map"] = f"{'column' if weight is None else 'mean'} of {what.text}"
    if weight is None:
        own, factor = column_unit(what.unit, volume.unit)
        values = integrals(volume, [what.number], camera, **how)[0]
    else:
        by = Quantity.of(volume.seen_by(camera), weight, "weight")
        told["weight"] = by.text
        own, factor = what.unit, 1.0
        weighed = product(what.number, by.number)
        total, weights = integrals(volume, [weighed, by.number], camera, **how)
        with np.errstate(invalid="ignore", divide="ignore"):
            values = np.where(weights != 0, total / weights, np.nan)
    target, more = converted(own, unit, f"the column of {what.text!r}")
    return as_map(factor * more * values, target, volume, camera, told)
