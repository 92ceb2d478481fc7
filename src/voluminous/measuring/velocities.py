"""Moments along the lines of sight: column, mean velocity and velocity dispersion."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..expressions import product, shifted
from ..progress import Progress, with_progress
from .columns import as_map, integrals
from .quantity import CellQuantity, check_volume, integral_unit

if TYPE_CHECKING:
    from ..cameras import Camera
    from ..expressions import Expression
    from ..image import Image
    from ..units import Unit
    from ..volume import Volume


_MOST = 4


@dataclass(frozen=True)
class Moments:
    """Moments of a velocity with the weight of a quantity.

    Attributes
    ----------
    column : Image
        ∫ q ds.
    mean : Image or None
        ⟨v⟩ = ∫ q v ds / ∫ q ds.
    dispersion : Image or None
        σ = √⟨(v - ⟨v⟩)²⟩.
    central : tuple of Image
        ⟨(v - ⟨v⟩)ᵏ⟩ for k = 2, 3, … as asked for.
    """

    column: Image
    mean: Image | None = None
    dispersion: Image | None = None
    central: tuple[Image, ...] = ()

    def __iter__(self) -> Iterator[Image]:
        """Give column, mean and dispersion, as far as they were asked for."""
        return iter([m for m in (self.column, self.mean, self.dispersion) if m is not None])


@with_progress
def moments(
    volume: Volume,
    quantity: str | Expression,
    camera: Camera,
    velocity: str | Expression = "velocity",
    n: int = 2,
    *,
    method: str = "rays",
    samples: int = 1,
    precision: str = "double",
    device: str = "auto",
    progress: Progress = None,
) -> Moments:
    """Return the first moments of a velocity along the lines of sight.

    Parameters
    ----------
    volume, quantity, camera
        As for `column`; the quantity is the weight, such as ``"density"``.
    velocity : str or Expression
        A vector (its component along the line of sight is taken, positive away from the observer),
        or any expression.
    n : int
        The highest moment: 0 for the column, 1 for the mean too, 2 for the dispersion, up to 4.
    method, samples, precision, device, progress
        As for `column`. Dispersions are differences: take double precision.

    Returns
    -------
    Moments
        Images `column`, `mean` and `dispersion`; NaN where the column is zero.

    Raises
    ------
    InputError
        If `n` is not from 0 to 4.
    """
    if not isinstance(n, Integral) or not 0 <= n <= _MOST:
        raise InputError(f"n, the highest moment, must be from 0 to {_MOST}, got {n!r}")
    check_volume(volume)
    seen = volume.seen_by(camera)
    if isinstance(velocity, str) and velocity not in seen and f"los({velocity!r})" in seen:
        velocity = f"los({velocity!r})"
    weight, speed = CellQuantity.of(seen, quantity), CellQuantity.of(seen, velocity, "velocity")
    middle = _typical(seen, weight, speed)
    v = shifted(speed.number, -middle)
    powers = [product(weight.number, *[v] * k) for k in range(n + 1)]
    how: dict[str, Any] = {"method": method, "samples": samples}
    options: dict[str, Any] = {"precision": precision, "device": device, "progress": progress}
    sums = integrals(volume, powers, camera, **how, **options)

    def image(values: np.ndarray, unit: Unit, what: str) -> Image:
        provenance = {"quantity": weight.text, "velocity": speed.text, **how, "map": what}
        return as_map(values, unit, volume, camera, provenance)

    unit, factor = integral_unit(weight.unit, volume.unit)
    column = image(factor * sums[0], unit, "column")
    with np.errstate(invalid="ignore", divide="ignore"):
        raw = [np.where(sums[0] != 0, s / sums[0], np.nan) for s in sums]
    if n == 0:
        return Moments(column)
    mean = image(middle + raw[1], speed.unit, "mean velocity")
    if n == 1:
        return Moments(column, mean)
    central = [_central(raw, k) for k in range(2, n + 1)]
    dispersion = image(np.sqrt(np.maximum(central[0], 0.0)), speed.unit, "dispersion")
    images = tuple(
        image(moment, None if speed.unit is None else speed.unit**k, f"central moment {k}")
        for k, moment in enumerate(central, 2)
    )
    return Moments(column, mean, dispersion, images)


def _typical(volume: Volume, weight: CellQuantity, speed: CellQuantity) -> float:
    """Return a velocity to subtract from all, so that squares of small differences keep digits.

    The mean of some cells will do, since it is added again. Absolute weights are taken: those of
    both signs could add up to nearly zero, and the quotient exceed all velocities.
    """
    last = min(volume.grid.size, 1 << 16)
    w, v = (volume.evaluate_cells(q.expression, 0, last) for q in (weight, speed))
    w = np.abs(w)
    total = float(np.nansum(w))
    with np.errstate(all="ignore"):  # a quotient by a density that is zero, say
        mean = float(np.nansum(w * v)) / total if total else 0.0
    return mean if np.isfinite(mean) else 0.0


def _central(raw: list[np.ndarray], k: int) -> np.ndarray:
    """Return ⟨(v - m)ᵏ⟩, with m = raw[1], from the moments about another point."""
    terms = [math.comb(k, i) * (-raw[1]) ** (k - i) * raw[i] for i in range(2, k + 1)]
    # The terms of i = 0 and 1 are (-m)ᵏ and -k (-m)ᵏ.
    return sum(terms, (1 - k) * (-raw[1]) ** k)
