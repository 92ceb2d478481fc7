"""What rays find on their way, in place of what they gather: a place, the largest value."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..errors import InputError, check_name
from ..media import Coefficients
from ..progress import Progress, with_progress
from ..rendering import prepare
from ..rendering.march import MarchState
from ..rendering.tracer import RayTracer
from ..schemes.base import Position, Scheme, Source
from ..schemes.path import Path
from .cells import condition as converted_condition
from .cells import with_known
from .columns import as_map, column, depth_map
from .quantity import CellQuantity, check_volume, converted

if TYPE_CHECKING:
    from ..backend.types import Float
    from ..cameras import Camera
    from ..grids.contract import Ray, Segment, Track
    from ..image import Image
    from ..media import Medium
    from ..volume import Volume


class Scanner(Scheme):
    """A scheme that gathers nothing: what it carries is what it has found.

    Attributes
    ----------
    recorded : int
        How many of the numbers that it carries are to be known in the end: those that come first.
    """

    complete = True
    recorded = 1

    def count(self, numbers: Any) -> int:
        """Return `recorded`, where it depends on what is integrated."""
        return self.recorded

    def after_hidden(self, carried: list[Float], onward: list[Float]) -> list[Any]:
        """Go on as before: nothing is found in cells without values."""
        return carried


NOTHING = Path([], [], [])


class Scan(RayTracer):
    """Rays that tell what their scheme, a `Scanner`, carries in the end."""

    @property
    def counts(self) -> tuple[int, int, int]:
        scanner: Any = self.job.scheme
        return scanner.count(self.source.numbers), 0, 0

    def nothing(self) -> Path:
        return NOTHING

    def march(self, ray: Ray) -> MarchState:
        state = super().march(ray)
        return replace(state, path=Path(state.carried[: self.counts[0]], [], []))


@dataclass
class Scanned:
    """What the rays through the pixels' centres have found.

    Attributes
    ----------
    values : float64 array, shape (recorded, ny, nx)
    unit, length : float
        What tabulated coefficients are multiplied by, to be those of the medium, and distances, to
        be in the volume's unit: single precision may not hold them.
    """

    values: np.ndarray
    unit: float
    length: float


def scan(volume: Volume, medium: Medium, camera: Camera, scheme: Scheme, **options: Any) -> Scanned:
    """Follow the rays through the pixels' centres."""
    job, _ = prepare(volume, medium, camera, scheme=scheme, cutoff=0.0, **options)
    nx, ny = job.frame.pixels
    source = job.source()
    paths, numbers = Scan(job, source, 0.0).frame(), source.numbers
    values = np.stack(paths.emission).astype(np.float64).reshape(-1, ny, nx)
    return Scanned(values, numbers.unit / volume.grid.scale, volume.grid.scale)


def distance(track: Track, t: Any) -> Any:
    """Return how far a point of a ray is from its origin, in units of the scale (traced)."""
    return type(t)(track.entry + t)


_SIGNS = {"max": 1.0, "min": -1.0}
HOW = ("max", "min", "first", "integral", "mean")


@with_progress
def project(
    volume: Volume,
    quantity: Any,
    camera: Camera,
    how: str = "max",
    *,
    depth: bool = False,
    unit: Any = None,
    precision: str = "single",
    device: str = "auto",
    progress: Progress = None,
) -> Any:
    """Return a projection of a quantity along the lines of sight, such as its maximum.

    A quantity is constant in a cell. Cells without a value (NaN) are left out.

    Parameters
    ----------
    volume, quantity, camera
        As for `column`. For ``how="first"`` a condition such as ``"density > 1e-18"``, which holds
        where it is not zero; numbers may have units on the right of a comparison.
    how : {"max", "min", "first", "integral", "mean"}
        ``"max"`` is the maximum-intensity projection (MIP), ``"min"`` the minimum; ``"integral"``
        is ∫ q ds, as `column` gives it; ``"mean"`` is ∫ q ds / ∫ ds over cells with a value.
        ``"first"`` is the distance at which rays enter the first cell in which the condition holds.
    depth : bool
        For ``"max"`` and ``"min"``: return also where the extreme is, as a second map. Distances
        are those of the middle of the cell's chord from the observer; for an orthographic camera
        from the plane through its centre, away from the observer.
    unit : str or unit, optional
        Of the map, as for `column`; where there are two, of the extremes.
    precision, device, progress
        As for `render`.

    Returns
    -------
    Image or (Image, Image)
        One channel, shape (ny, nx, 1), in the unit of the quantity, for ``"integral"`` times a
        length, for ``"first"`` a length. NaN where a line of sight misses everything; 0 for
        ``"integral"``.

    Raises
    ------
    UnknownNameError
        For a field or projection that does not exist; names the nearest.
    InputError
        If there is no depth of such a projection, or the quantity has no value in any cell.
    UnitsError
        If the map is not of the unit.

    Examples
    --------
    >>> import numpy as np
    >>> import voluminous as vm
    >>> grid = vm.CartesianGrid.uniform((2, 2, 2), (0, 1))
    >>> volume = vm.Volume(grid, a=np.arange(8.0).reshape(2, 2, 2))
    >>> camera = vm.Orthographic(width=1, resolution=2)
    >>> vm.project(volume, "a", camera, how="max").intensity[..., 0].tolist()
    [[1.0, 5.0], [3.0, 7.0]]
    """
    check_name("how", how, HOW)
    check_volume(volume)
    if depth and how not in _SIGNS:
        raise InputError(f"depth=True is for how='max' and 'min', got how={how!r}")
    options: dict[str, Any] = {"precision": precision, "device": device, "progress": progress}
    if how in ("integral", "mean"):
        total = column(
            volume, quantity, camera, weight=1 if how == "mean" else None, unit=unit, **options
        )
        return total.replace(provenance={**(total.provenance or {}), "how": how})
    if how == "first":
        return _first(volume, quantity, camera, unit, options)
    what = CellQuantity.of(volume.seen_by(camera), quantity)
    found = _scanned(volume, what, camera, _Largest(_SIGNS[how]), **options)
    kind = f"{how}imum"
    told = {"quantity": what.text, "how": how, "map": f"{kind} of {what.text}"}
    target, factor = converted(what.unit, unit, f"the {kind} of {what.text!r}")
    values = as_map(factor * found.unit * found.values[0], target, volume, camera, told)
    if not depth:
        return values
    return values, depth_map(found.length * found.values[1], volume, camera, told)


def _first(volume: Volume, condition: Any, camera: Camera, unit: Any, options: Any) -> Image:
    what = converted_condition(volume.seen_by(camera), condition, "condition")
    found = _scanned(volume, what, camera, _First(), **options)
    told = {"condition": what.text, "how": "first"}
    target, factor = converted(volume.unit, unit, "the distance")
    told["map"] = "depth"
    return as_map(factor * found.length * found.values[0], target, volume, camera, told)


def _scanned(
    volume: Volume, what: CellQuantity, camera: Camera, scheme: Scanner, **options: Any
) -> Scanned:
    seen, (known,) = with_known(volume.seen_by(camera), [what.expression])
    return scan(seen, Coefficients(known, 0), camera, scheme, **options)


class _Largest(Scanner):
    """Carry the largest value, times a sign, and where it is."""

    name = "extreme"
    recorded = 2
    everywhere = True

    def __init__(self, sign: float) -> None:
        self.sign = sign

    def start(self, position: Position, source: Source) -> list[Any]:
        return [source.backend.Float(np.nan), source.backend.Float(np.nan)]

    def solve(
        self, segment: Segment, source: Source, carried: list[Float]
    ) -> tuple[Path, list[Float]]:
        (value,), _ = source.at(segment)
        best, place = carried
        larger = dr.isnan(best) | (value * self.sign > best * self.sign)
        larger &= segment.active & (segment.length > 0.0)
        here = distance(segment.track, 0.5 * (segment.begin + segment.end))
        return NOTHING, [dr.select(larger, value, best), dr.select(larger, here, place)]


class _First(Scanner):
    """Carry where rays enter the first cell with a number that is not zero."""

    name = "first hit"

    def start(self, position: Position, source: Source) -> list[Any]:
        return [source.backend.Float(np.nan)]

    def solve(
        self, segment: Segment, source: Source, carried: list[Float]
    ) -> tuple[Path, list[Float]]:
        (value,), _ = source.at(segment)
        hit = dr.isnan(carried[0]) & (value != 0.0) & segment.active & (segment.length > 0.0)
        return NOTHING, [dr.select(hit, distance(segment.track, segment.begin), carried[0])]
