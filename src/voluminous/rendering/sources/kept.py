"""What is made of fields and a medium for one picture, and kept with the volume for the next."""

from __future__ import annotations

import functools
from typing import Any

from ...expressions.interval import Interval
from ..cache import Cache
from ..coefficients.classify import Classifier
from ..empty_space.blocks import (
    Window,
    coordinate_ranges,
    field_ranges,
    visible_blocks,
    worthwhile_blocks,
)
from ..interpolants.coarse import wide_steps
from ..interpolants.limits import difference_limits
from ..interpolants.pyramid import make_pyramid


def get_lattices(classifier: Classifier, cache: Cache, blocks: Any = None) -> dict[str, Any]:
    """Return all fields as rays gather them; kept with the volume."""
    volume, backend = classifier.volume, classifier.backend
    steps = blocks.steps if blocks is not None else ()
    names = [name for name in classifier.medium.names if name in volume]
    keys = {n: ("lattice", n, backend, cache.statistics.digest(n)) for n in names}
    found = {name: cache.get(key) for name, key in keys.items()}
    lacking = [name for name in names if found[name] is None]
    made = volume.grid.lattice([volume.array(name) for name in lacking], backend)
    for name, lattice in zip(lacking, made, strict=True):
        found[name] = cache.put(keys[name], lattice)
    if not steps:
        return found

    def pyramid(name: str) -> Any:
        return make_pyramid(volume.array(name), found[name], steps, backend)

    return {n: cache.get_or_make((*keys[n], steps), functools.partial(pyramid, n)) for n in names}


def get_blocks(
    classifier: Classifier, cache: Cache, faint: float, window: Window, coarseness: float = 0.0
) -> Any:
    """Return the blocks that rays may leap over, or None; kept with the volume."""
    medium, backend = classifier.medium, classifier.backend
    if not classifier.grid.has_blocks:
        return None
    limits = difference_limits(classifier, coarseness)

    def make() -> Any:
        ranges = get_ranges(classifier, cache, window)
        visible = visible_blocks(classifier, ranges, faint, window)
        steps = None if limits is None else wide_steps(classifier, visible, ranges, limits)
        return worthwhile_blocks(visible, backend, window, steps)

    own = medium.visible_key()
    if own is None:
        return make()
    differences = None if limits is None else tuple(limit.key for limit in limits)
    key = (
        "blocks",
        own,
        faint,
        window,
        differences,
        cache.statistics.digests(medium.names),
        backend,
    )
    return cache.get_or_make(key, make)


def get_ranges(classifier: Classifier, cache: Cache, window: Window) -> dict[str, Interval]:
    """Return the values of all fields in and around every block; kept with the volume.

    Where there are no blocks, of the whole volume.
    """
    names = classifier.medium.names
    if not classifier.grid.has_blocks:
        return {name: classifier.statistics.range_of(name) for name in names}
    return {name: _ranges(classifier.volume, cache, name, window) for name in names}


def _ranges(volume: Any, cache: Cache, name: str, window: Window) -> Any:
    if name not in volume:
        return coordinate_ranges(name, volume.grid.edges, window)
    key = ("ranges", name, cache.statistics.digest(name), window)
    return cache.get_or_make(key, lambda: field_ranges(volume.array(name), window))
