"""The largest or smallest value on every line of sight, and where something begins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..errors import check_name
from ..media import Coefficients
from ..progress import Progress, with_progress
from .conditions import condition as converted_condition
from .known import with_known
from .maps import as_map, depth_map
from .quantity import Quantity, check_volume
from .scan import NOTHING, Scanned, Scanner, distance, scan

if TYPE_CHECKING:
    from ..image import Image

KINDS = ("maximum", "minimum")


@dataclass(frozen=True)
class Extreme:
    """An extreme value on every line of sight.

    Attributes
    ----------
    value : Image
        NaN where a line of sight misses everything.
    depth : Image
        Where it is: the distance of the middle of the cell's chord. From the observer; for an
        orthographic camera from the plane through its centre, away from the observer.
    """

    value: Image
    depth: Image


@with_progress
def extreme(
    volume: Any,
    quantity: Any,
    camera: Any,
    kind: str = "maximum",
    *,
    precision: str = "single",
    device: str = "auto",
    progress: Progress = None,
) -> Extreme:
    """Return the largest or smallest value of a quantity on every line of sight, and its depth.

    Parameters
    ----------
    volume, quantity, camera
        As for `column`.
    kind : {"maximum", "minimum"}
    precision, device, progress
        As for `render`.

    Returns
    -------
    Extreme
        Two maps, `value` and `depth`.
    """
    check_name("kind", kind, KINDS)
    check_volume(volume)
    what = Quantity.of(volume.seen_by(camera), quantity)
    scheme = _Largest(1.0 if kind == "maximum" else -1.0)
    options = {"precision": precision, "device": device, "progress": progress}
    found = _scanned(volume, what, camera, scheme, **options)
    value, depth = found.unit * found.values[0], found.length * found.values[1]
    quantity = what.text
    told = {"quantity": quantity, "kind": kind, "map": f"{kind} of {quantity}"}
    return Extreme(
        as_map(value, what.unit, volume, camera, told), depth_map(depth, volume, camera, told)
    )


@with_progress
def first_hit(
    volume: Any,
    condition: Any,
    camera: Any,
    *,
    precision: str = "single",
    device: str = "auto",
    progress: Progress = None,
) -> Image:
    """Return how deep the first cell lies in which a condition holds; NaN where it never does.

    Parameters
    ----------
    condition : str
        An expression such as ``"density > 1e-18"``; holds where it is not zero. Numbers may have
        units on the right of a comparison.

    Returns
    -------
    Image
        Distances as in `Extreme.depth`, of the point where rays enter the cell.
    """
    check_volume(volume)
    what = converted_condition(volume.seen_by(camera), condition, "condition")
    options = {"precision": precision, "device": device, "progress": progress}
    found = _scanned(volume, what, camera, _First(), **options)
    depth = found.length * found.values[0]
    return depth_map(depth, volume, camera, {"condition": what.text})


def _scanned(volume: Any, what: Quantity, camera: Any, scheme: Scanner, **options: Any) -> Scanned:
    """Return what rays find of a quantity in cells in which it has a value."""
    seen, (known,) = with_known(volume.seen_by(camera), [what.expression])
    return scan(seen, Coefficients(known, 0), camera, scheme, **options)


class _Largest(Scanner):
    """Carry the largest value, times a sign, and where it is."""

    name = "extreme"
    place = "cell"
    recorded = 2
    everywhere = True

    def __init__(self, sign: float) -> None:
        self.sign = sign

    def start(self, source: Any, walk: Any, track: Any, cursor: Any) -> list[Any]:
        """Carry nothing yet."""
        return [source.backend.Float(np.nan), source.backend.Float(np.nan)]

    def solve(
        self, source: Any, walk: Any, track: Any, segment: Any, carried: list[Any], backward: bool
    ) -> tuple[Any, list[Any]]:
        """Look at one cell; see `schemes.contract.Scheme`."""
        (value,), _ = source.at(segment.cell, segment.active)
        best, place = carried
        larger = dr.isnan(best) | (value * self.sign > best * self.sign)
        larger &= segment.active & (segment.length > 0.0)
        here = distance(track, 0.5 * (segment.begin + segment.end))
        return NOTHING, [dr.select(larger, value, best), dr.select(larger, here, place)]


class _First(Scanner):
    """Carry where rays enter the first cell with a number that is not zero."""

    name = "first hit"
    place = "cell"

    def start(self, source: Any, walk: Any, track: Any, cursor: Any) -> list[Any]:
        """Carry nothing yet."""
        return [source.backend.Float(np.nan)]

    def solve(
        self, source: Any, walk: Any, track: Any, segment: Any, carried: list[Any], backward: bool
    ) -> tuple[Any, list[Any]]:
        """Look at one cell; see `schemes.contract.Scheme`."""
        (value,), _ = source.at(segment.cell, segment.active)
        hit = dr.isnan(carried[0]) & (value != 0.0) & segment.active & (segment.length > 0.0)
        return NOTHING, [dr.select(hit, distance(track, segment.begin), carried[0])]
