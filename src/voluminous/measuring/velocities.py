"""Moments along the lines of sight: how much there is, how fast it moves, and how evenly."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..expressions import product, shifted
from ..progress import Progress, with_progress
from .columns import as_map, integrals
from .quantity import CellQuantity, check_volume, column_unit

if TYPE_CHECKING:
    from ..cameras import Camera
    from ..image import Image
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
    quantity: Any,
    camera: Camera,
    velocity: Any = "velocity",
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
    weight, speed = CellQuantity.of(seen, quantity), _along(seen, velocity)
    middle = _typical(seen, weight, speed)
    w, v = weight.number, shifted(speed.number, -middle)
    sums = integrals(
        volume,
        [product(w, *[v] * k) for k in range(n + 1)],
        camera,
        method=method,
        samples=samples,
        precision=precision,
        device=device,
        progress=progress,
    )
    unit, factor = column_unit(weight.unit, volume.unit)
    told = {
        "quantity": weight.text,
        "velocity": speed.text,
        "method": method,
        "samples": samples,
    }

    def image(values: np.ndarray, unit: Any, what: str) -> Image:
        return as_map(values, unit, volume, camera, {**told, "map": what})

    column = image(factor * sums[0], unit, "column")
    with np.errstate(invalid="ignore", divide="ignore"):
        raw = [np.where(sums[0] != 0, s / sums[0], np.nan) for s in sums]
    return Moments(column, *_images_of_speed(raw, middle, speed.unit, image))


def _images_of_speed(
    raw: list[np.ndarray], middle: float, unit: Any, image: Callable[..., Image]
) -> Iterator[Any]:
    """Yield mean, dispersion and central moments, as far as means of powers are known."""
    if len(raw) > 1:
        yield image(middle + raw[1], unit, "mean velocity")
    if len(raw) > 2:
        central = _central(raw)
        yield image(np.sqrt(np.maximum(central[0], 0.0)), unit, "dispersion")
        yield tuple(
            image(moment, None if unit is None else unit**k, f"central moment {k}")
            for k, moment in enumerate(central, 2)
        )


def _along(volume: Volume, velocity: Any) -> CellQuantity:
    """Return a vector's component along the line of sight, or the expression itself."""
    is_vector = isinstance(velocity, str) and velocity not in volume
    if is_vector and f"los({velocity!r})" in volume:
        return CellQuantity.of(volume, f"los({velocity!r})", "velocity")
    return CellQuantity.of(volume, velocity, "velocity")


def _typical(volume: Volume, weight: CellQuantity, speed: CellQuantity) -> float:
    """Return a velocity that is subtracted from all, so that squares of small ones differ.

    The mean of some cells will do: it is added again. Weights of both signs count alike, or their
    sum might be next to nothing, and the quotient beyond all velocities.
    """
    last = min(volume.grid.size, 1 << 16)
    w, v = (volume.evaluate_cells(q.expression, 0, last) for q in (weight, speed))
    w = np.abs(w)
    total = float(np.nansum(w))
    with np.errstate(all="ignore"):  # a quotient by a density that is zero, say
        mean = float(np.nansum(w * v)) / total if total else 0.0
    return mean if np.isfinite(mean) else 0.0


def _central(raw: list[np.ndarray]) -> list[np.ndarray]:
    """Return central moments from the second on, from those around another point."""
    m = raw[1]
    found = [raw[2] - m**2]
    if len(raw) > 3:
        found.append(raw[3] - 3 * m * raw[2] + 2 * m**3)
    if len(raw) > 4:
        found.append(raw[4] - 4 * m * raw[3] + 6 * m**2 * raw[2] - 3 * m**4)
    return found
