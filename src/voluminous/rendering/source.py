"""Where a scheme gets its coefficients from: a table, fields interpolated on the ray, or cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..backend import dr
from ..expressions.interval import Interval
from ..grids.contract import has_blocks
from ..memory import check_memory, fits
from .coefficients.classify import Classifier
from .coefficients.digits import Exactness, exactness
from .coefficients.numbers import plan_numbers
from .coefficients.on_ray import OnRay
from .coefficients.own_coordinates import ray_coordinates
from .coefficients.tables import cell_table, vertex_table
from .empty_space.blocks import (
    CELLS,
    DUAL,
    Window,
    coordinate_ranges,
    field_ranges,
    visible_blocks,
    worthwhile_blocks,
)
from .empty_space.pruned import can_be_pruned, interpolated, pruned_walk, tabled
from .interpolants.coarse import allowed_differences, wide_steps
from .interpolants.interpolated import Interpolated
from .interpolants.lattice import make_lattice
from .interpolants.pyramid import make_pyramid
from .store import SLABS, Store

_ADVICE = (
    "use precision='single', scheme='first-order' (which can do without a table), "
    "or a coarser or smaller volume"
)
# The least that a precision can tell of a peak.
_FAINTEST = {"single": 1e-37, "double": 1e-300}
# Rays that pass along a shell where it is faint do so for some path lengths at least. For more than
# the second number nothing need be known: the faintest part of a peak is of a width as before.
_SOME_PATHS, _MOST_PATHS = 10.0, 1e12
# What pictures on curvilinear grids are off by, of the tolerance: nearly all of them by less.
_LOST_BY_CUBICS = 0.1
# What places lose, in ε: seen of a shell with σ = 1e-4 dex in a field of 3 dex, and at most.
_LOST_PER_EPS, _MOST_LOST = 0.1, 1e-3
# What may be neglected of tabulated coefficients, as a fraction of their peak: below rounding.
_FAINT = {"single": 1e-9, "double": 1e-18}


def get_source(
    volume: Any,
    medium: Any,
    scheme: Any,
    backend: Any,
    steps: float,
    report: Callable[..., None],
    tolerance: float = 1e-3,
    faintest: bool = False,
    *,
    store: Store,
    whole: bool = True,
) -> Any:
    """Return the coefficients for a scheme.

    Parameters
    ----------
    steps : float
        About how many cells the rays will cross in all.
    report : callable
        Called as ``report(done, total)`` while classifying.
    tolerance : float
        What a scheme that controls its error is to keep to.
    faintest : bool
        Leave nothing out, however faint.
    store : Store
        What was made of the volume before.
    whole : bool
        No cell is hidden: rays may cross several at once.
    """
    numbers = plan_numbers(medium, scheme, backend)
    classifier = Classifier(volume, medium, numbers, backend, store.extremes)
    if scheme.place == "field":
        return _interpolated(classifier, store, scheme, tolerance, faintest, whole)
    needed = table_bytes(classifier, scheme, backend)
    crowded = scheme.place == "cell" and _crowded(numbers, needed, volume.grid.size / steps)
    if crowded and not volume.tables:  # not even hashed: that takes a while for 1024³
        return _on_ray(classifier, backend)
    complete = getattr(scheme, "complete", False)  # it leaves nothing out, however faint
    everywhere = getattr(scheme, "everywhere", False)  # nor where there is nothing
    faint = 0.0 if complete else _FAINT[backend.precision]
    key = _key(classifier, scheme, store, (faint, everywhere))
    found = None if key is None else store.get(key)
    if found is not None:
        return replace(found, numbers=numbers.reuse(found.numbers))
    if crowded:
        return _on_ray(classifier, backend)
    check_memory(needed + SLABS, f"the table of scheme {scheme.name!r}", _ADVICE)
    numbers.normalise(classifier.largest())
    make = cell_table if scheme.place == "cell" else vertex_table
    table = make(classifier, backend, report)
    if everywhere:
        return table if key is None else store.keep(key, table)
    table.blocks = _blocks(classifier, store, faint, CELLS)
    if whole and scheme.place == "cell" and hasattr(volume.grid, "pruned"):
        table.walk = pruned_walk(volume.grid, tabled(table, faint), backend, "cells")
    return table if key is None else store.keep(key, table)


def _interpolated(
    classifier: Classifier,
    store: Store,
    scheme: Any,
    tolerance: float,
    faintest: bool,
    whole: bool,
) -> Interpolated:
    """Return the medium on interpolated fields; their lattices are kept with the volume."""
    volume, backend = classifier.volume, classifier.backend
    needed = _remember(classifier, store)
    classifier.numbers.normalise(classifier.largest())
    # Of thick shells even the tails are dense: what is neglected counts in optical depth per cell.
    dense = float(classifier.numbers.densest(classifier.largest()))
    faint = min(0.01 * tolerance, 1e-3) / max(1.0, 10.0 * dense)
    # Without error control nobody asks what is left out.
    paths = _path_lengths(classifier) if scheme.controlled else _SOME_PATHS
    faint *= _SOME_PATHS / paths
    least = _FAINTEST[backend.precision]
    faint = least if faintest else max(faint, least)
    real = backend.Float if needed.single else backend.Wide
    context = replace(
        classifier.context(real),
        narrow=backend.Float,
        scale=volume.grid.scale,
        radiance=classifier.numbers.unit,
        limits=_limits(classifier, real),
        faint=faint,
        coordinates=ray_coordinates(volume, classifier.medium.names),
    )
    blocks = _blocks(classifier, store, faint, DUAL, scheme.coarseness if whole else 0.0)
    lattices = get_lattices(classifier, store, blocks)
    source = Interpolated(classifier, lattices, context, blocks, paths)
    if whole:
        source.walk = _pruned(classifier, store, lattices, faint)
    if scheme.controlled:
        source.lost = _lost_by_places(backend, needed.contrast)
        _keep_walk(source, tolerance, needed.contrast)
    return source


def _lost_by_places(backend: Any, contrast: float) -> float:
    """Return the part of a pixel that is lost because places are rounded.

    By as much, in parts of their range, scalars are off: a shell that is grazed shows more or less.
    """
    return min(_LOST_PER_EPS * float(np.finfo(backend.dtype).eps) * contrast, _MOST_LOST)


def _keep_walk(source: Interpolated, tolerance: float, contrast: float) -> None:
    """Where fields along a segment are no polynomials, have them near enough to one."""
    walk = source.walk or source.classifier.grid.walk(source.backend, source.walk_kind)
    if hasattr(walk, "kept_to"):
        source.walk = walk.kept_to(tolerance / contrast)
        source.lost += _LOST_BY_CUBICS * tolerance


def _path_lengths(classifier: Classifier) -> float:
    """Return how many path lengths a ray may follow a shell for: some, or all the way across."""
    grid, largest = classifier.grid, classifier.largest()
    diagonal = float(np.linalg.norm(np.ptp(grid.bounds, axis=1))) / grid.scale
    return float(np.clip(classifier.numbers.paths(largest) * diagonal, _SOME_PATHS, _MOST_PATHS))


def _pruned(classifier: Classifier, store: Store, lattices: dict[str, Any], faint: float) -> Any:
    """Return the walk through the leaves that may show something, or None; kept."""
    medium, backend = classifier.medium, classifier.backend
    if not can_be_pruned(classifier):
        return None

    def make() -> Any:
        visible = interpolated(classifier, lattices, faint)
        return pruned_walk(classifier.grid, visible, backend, "dual")

    own = medium.visible_key()
    if own is None:
        return make()
    return store.kept(("pruned", own, faint, store.digests(medium.names), backend), make)


def _remember(classifier: Classifier, store: Store) -> Exactness:
    """Have what was found for the same medium before, and return how exact expressions must be."""
    own = classifier.medium.key()

    def make() -> tuple[list[float], Exactness]:
        return classifier.largest(), exactness(classifier)

    if own is None:
        return make()[1]
    # Shapes have other numbers than what is made of all their colours.
    kind = type(classifier.numbers).__name__
    key = ("numbers", kind, own, store.digests(classifier.medium.names))
    found: tuple[list[float], Exactness] = store.kept(key, make)
    classifier.expect(found[0])
    return found[1]


def _limits(classifier: Classifier, real: Any) -> dict[str, tuple[Any, Any]]:
    """Return the least and largest values of all fields, as numbers of a kernel."""
    volume = classifier.volume
    extremes = {n: classifier.extremes(n) for n in classifier.medium.names if n in volume}
    return {
        name: (dr.opaque(real, low), dr.opaque(real, high))
        for name, (low, high) in extremes.items()
    }


def get_lattices(classifier: Classifier, store: Store, blocks: Any = None) -> dict[str, Any]:
    """Return all fields as rays gather them; kept with the volume."""
    volume, backend = classifier.volume, classifier.backend
    steps = blocks.steps if blocks is not None else ()

    def make(name: str) -> Any:
        key = ("lattice", name, backend.device, backend.precision, store.digest(name))
        fine = store.kept(key, lambda: make_lattice(volume.grid, volume.array(name), backend))
        if not steps:
            return fine
        return store.kept(
            (*key, steps), lambda: make_pyramid(volume.array(name), fine, steps, backend)
        )

    return {name: make(name) for name in classifier.medium.names if name in volume}


def _blocks(
    classifier: Classifier, store: Store, faint: float, window: Window, coarseness: float = 0.0
) -> Any:
    """Return the blocks that rays may leap over, or None; kept with the volume."""
    medium, backend = classifier.medium, classifier.backend
    if not has_blocks(classifier.grid):
        return None
    allowed = allowed_differences(classifier, coarseness)

    def make() -> Any:
        ranges = get_ranges(classifier, store, window)
        visible = visible_blocks(classifier, ranges, faint, window)
        steps = None if allowed is None else wide_steps(classifier, visible, ranges, allowed)
        return worthwhile_blocks(visible, backend, window, steps)

    own = medium.visible_key()
    if own is None:
        return make()
    differences = allowed and tuple((expr.text, most) for expr, most in allowed)
    key = ("blocks", own, faint, window, differences, store.digests(medium.names), backend)
    return store.kept(key, make)


def get_ranges(classifier: Classifier, store: Store, window: Window) -> dict[str, Interval]:
    """Return the values of all fields in and around every block; kept with the volume.

    Where there are no blocks, of the whole volume.
    """
    names = classifier.medium.names
    if not has_blocks(classifier.grid):
        return {name: classifier.range_of(name) for name in names}
    return {name: _ranges(classifier.volume, store, name, window) for name in names}


def _ranges(volume: Any, store: Store, name: str, window: Window) -> Any:
    if name not in volume:
        return coordinate_ranges(name, volume.grid.edges, window)
    key = ("ranges", name, store.digest(name), window)
    return store.kept(key, lambda: field_ranges(volume.array(name), window))


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
    places = grid.vertex_count if scheme.place == "vertex" else grid.size
    return places * classifier.numbers.count * backend.dtype.itemsize


def _key(classifier: Classifier, scheme: Any, store: Store, left_out: tuple[Any, ...]) -> Any:
    """Return what a table depends on; None if that cannot be told."""
    own = classifier.numbers.key()
    if own is None:
        return None
    backend = classifier.backend
    names = classifier.medium.names
    return (own, scheme.place, left_out, backend.device, backend.precision, store.digests(names))
