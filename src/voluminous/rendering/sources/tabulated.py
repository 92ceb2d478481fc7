"""Coefficients per cell or vertex: from a table, or cell by cell on the ray."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ...memory import check_memory, fits
from ..cache import SLABS, Cache
from ..coefficients.classify import Classifier
from ..coefficients.on_ray import OnRay
from ..coefficients.tables import Table, cell_table, vertex_table
from ..empty_space.blocks import CELLS
from ..empty_space.pruned import pruned_walk, tabled
from .kept import get_blocks

_ADVICE = (
    "use precision='single', scheme='first-order' (which can do without a table), "
    "or a coarser or smaller volume"
)
# What may be neglected of tabulated coefficients, as a fraction of their peak: below rounding.
_FAINT = {"single": 1e-9, "double": 1e-18}


def tabulated(
    classifier: Classifier,
    cache: Cache,
    scheme: Any,
    steps: float,
    report: Callable[..., None],
    whole: bool,
) -> Any:
    """Return a table, made or kept; or the medium on the ray, where a table is not worth it."""
    volume, backend, numbers = classifier.volume, classifier.backend, classifier.numbers
    needed = table_bytes(classifier, scheme, backend)
    crowded = scheme.coefficients_at == "cell" and _crowded(
        numbers, needed, volume.grid.size / steps
    )
    if crowded and not volume.tables:  # not even hashed: that takes a while for 1024³
        return _on_ray(classifier, backend)
    everywhere = scheme.everywhere
    faint = 0.0 if scheme.complete else _FAINT[backend.precision]
    key = _key(classifier, scheme, cache, (faint, everywhere))
    found = None if key is None else cache.get(key)
    if found is not None:
        return replace(found, numbers=numbers.reuse(found.numbers))
    if crowded:
        return _on_ray(classifier, backend)
    check_memory(needed + SLABS, f"the table of scheme {scheme.name!r}", _ADVICE)
    numbers.normalise(classifier.largest())
    make = cell_table if scheme.coefficients_at == "cell" else vertex_table
    table = make(classifier, backend, report)
    if not everywhere:
        table.blocks = get_blocks(classifier, cache, faint, CELLS)
        table.walk = _pruned(table, volume.grid, scheme, faint) if whole else None
    return table if key is None else cache.put(key, table)


def _pruned(table: Table, grid: Any, scheme: Any, faint: float) -> Any:
    if scheme.coefficients_at != "cell" or not grid.can_be_pruned:
        return None
    return pruned_walk(grid, tabled(table, faint), table.backend, "cells")


def _crowded(numbers: Any, needed: int, cells_per_step: float) -> bool:
    """Return True if the medium is better evaluated on the ray than for all cells beforehand.

    That is so where the rays visit few of the cells. But a table, if it can be recognised and
    leaves memory for other things, serves the next pictures too: of 512³ cells by 400² rays the
    first takes 3.1 s and the next 0.45 s, on the ray each takes 1.6 s.
    """
    if not fits(needed + SLABS):
        return True
    if cells_per_step < 0.5:
        return False
    return numbers.key() is None or not fits(4 * needed)


def _on_ray(classifier: Classifier, backend: Any) -> OnRay:
    classifier.numbers.normalise(classifier.largest())
    return OnRay(classifier, backend)


def table_bytes(classifier: Classifier, scheme: Any, backend: Any) -> int:
    """Return the memory of a scheme's table."""
    grid = classifier.grid
    places = grid.vertex_count if scheme.coefficients_at == "vertex" else grid.size
    return places * classifier.numbers.count * backend.dtype.itemsize


def _key(classifier: Classifier, scheme: Any, cache: Cache, left_out: tuple[Any, ...]) -> Any:
    own = classifier.numbers.key()
    if own is None:
        return None
    backend = classifier.backend
    names = classifier.medium.names
    return (own, scheme.coefficients_at, left_out, backend, cache.statistics.digests(names))
