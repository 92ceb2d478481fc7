"""Where a scheme gets its coefficients from: a table, fields interpolated on the ray, or cells."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..backend import dr
from ..expressions.interval import Interval
from ..memory import check_memory, fits
from .classify import Classifier
from .digits import enough_in_single
from .empty import (
    CELLS,
    DUAL,
    Window,
    coordinate_ranges,
    field_ranges,
    visible_blocks,
    worthwhile_blocks,
)
from .interpolated import Interpolated
from .lattice import make_lattice
from .numbers import plan_numbers
from .on_ray import OnRay
from .store import SLABS, Store
from .tables import cell_table, vertex_table

_ADVICE = (
    "use precision='single', scheme='first-order' (which can do without a table), "
    "or a coarser or smaller volume"
)
# The least that a precision can tell of a peak.
_FAINTEST = {"single": 1e-37, "double": 1e-300}
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
    """
    volume.refresh()  # derivatives of fields that were changed in place
    numbers = plan_numbers(medium, scheme, backend)
    store = Store(volume)
    extremes = store.extremes if scheme.place == "field" else None
    classifier = Classifier(volume, medium, numbers, backend, extremes)
    if scheme.place == "field":
        return _interpolated(classifier, store, tolerance, faintest)
    needed = table_bytes(classifier, scheme, backend)
    crowded = scheme.place == "cell" and _crowded(numbers, needed, volume.grid.size / steps)
    if crowded and not volume.tables:  # not even hashed: that takes a while for 1024³
        return _on_ray(classifier, backend)
    key = _key(classifier, scheme, store)
    found = None if key is None else store.get(key)
    if found is not None:
        return replace(found, numbers=numbers.reuse(found.numbers))
    if crowded:
        return _on_ray(classifier, backend)
    check_memory(needed + SLABS, f"the table of scheme {scheme.name!r}", _ADVICE)
    numbers.normalise(classifier.largest())
    make = cell_table if scheme.place == "cell" else vertex_table
    table = make(classifier, backend, report)
    table.blocks = _blocks(classifier, store, _FAINT[backend.precision], CELLS)
    return table if key is None else store.keep(key, table)


def _interpolated(
    classifier: Classifier, store: Store, tolerance: float, faintest: bool
) -> Interpolated:
    """Return the medium on interpolated fields; their lattices are kept with the volume."""
    volume, backend = classifier.volume, classifier.backend
    classifier.numbers.normalise(classifier.largest())
    lattices = get_lattices(classifier, store)
    # Of thick shells even the tails are dense: what is neglected counts in optical depth per cell.
    dense = classifier.numbers.densest(classifier.largest())
    faint = min(0.01 * tolerance, 1e-3) / max(1.0, 10.0 * dense)
    least = _FAINTEST[backend.precision]
    faint = least if faintest else max(faint, least)
    real = backend.Float if enough_in_single(classifier) else backend.Wide
    context = replace(
        classifier.context(real),
        narrow=backend.Float,
        scale=volume.grid.scale,
        radiance=classifier.numbers.unit,
        limits=_limits(classifier, real),
        faint=faint,
    )
    return Interpolated(classifier, lattices, context, _blocks(classifier, store, faint, DUAL))


def _limits(classifier: Classifier, real: Any) -> dict[str, tuple[Any, Any]]:
    """Return the least and largest values of all fields, as numbers of a kernel."""
    volume = classifier.volume
    extremes = {n: classifier.extremes(n) for n in classifier.medium.names if n in volume}
    return {
        name: (dr.opaque(real, low), dr.opaque(real, high))
        for name, (low, high) in extremes.items()
    }


def get_lattices(classifier: Classifier, store: Store) -> dict[str, Any]:
    """Return all fields as rays gather them; kept with the volume."""
    volume, backend = classifier.volume, classifier.backend
    return {
        name: store.kept(
            ("lattice", name, backend.device, backend.precision, store.digest(name)),
            functools.partial(make_lattice, volume.array(name), backend),
        )
        for name in classifier.medium.names
        if name in volume
    }


def _blocks(classifier: Classifier, store: Store, faint: float, window: Window) -> Any:
    """Return the blocks that rays may leap over, or None; kept with the volume."""
    medium, backend = classifier.medium, classifier.backend

    def make() -> Any:
        ranges = get_ranges(classifier, store, window)
        visible = visible_blocks(classifier, ranges, faint, window)
        return worthwhile_blocks(visible, backend, window)

    own = medium.visible_key()
    if own is None:
        return make()
    return store.kept(("blocks", own, faint, window, store.digests(medium.names), backend), make)


def get_ranges(classifier: Classifier, store: Store, window: Window) -> dict[str, Interval]:
    """Return the values of all fields in and around every block; kept with the volume."""
    names = classifier.medium.names
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
    extra = 1 if scheme.place == "vertex" else 0
    places = int(np.prod([n + extra for n in classifier.grid.shape], dtype=object))
    return places * classifier.numbers.count * backend.dtype.itemsize


def _key(classifier: Classifier, scheme: Any, store: Store) -> Any:
    """Return what a table depends on; None if that cannot be told."""
    own = classifier.numbers.key()
    if own is None:
        return None
    backend = classifier.backend
    names = classifier.medium.names
    return (own, scheme.place, backend.device, backend.precision, store.digests(names))
