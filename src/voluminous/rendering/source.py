"""Where a scheme gets its coefficients from: a table made beforehand, or the ray."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..memory import check_memory, fits
from .classify import Classifier
from .numbers import plan_numbers
from .on_ray import OnRay
from .tables import Table, cell_table, vertex_table

# Tables kept per volume: turning only the camera, or going back and forth between two schemes or
# media, classifies nothing again.
_KEPT = 4
# Temporary numbers while classifying.
_SLABS = 96 << 20
_ADVICE = (
    "use precision='single', scheme='first-order' (which can do without a table), "
    "or a coarser or smaller volume"
)


def get_source(
    volume: Any, medium: Any, scheme: Any, backend: Any, steps: float, report: Callable[..., None]
) -> Any:
    """Return the coefficients for a scheme.

    Parameters
    ----------
    steps : float
        About how many cells the rays will cross in all.
    report : callable
        Called as ``report(done, total)`` while classifying.
    """
    numbers = plan_numbers(medium, scheme, backend)
    classifier = Classifier(volume, medium, numbers, backend)
    needed = table_bytes(classifier, scheme, backend)
    crowded = scheme.place == "cell" and _crowded(numbers, needed, volume.grid.size / steps)
    if crowded and not volume.tables:  # not even hashed: that takes a second for 1024³
        return _on_ray(classifier, backend)
    key = _key(classifier, scheme)
    if key is not None and key in volume.tables:
        volume.tables.move_to_end(key)
        table = volume.tables[key]
        return replace(table, numbers=numbers.reuse(table.numbers))
    if crowded:
        return _on_ray(classifier, backend)
    check_memory(needed + _SLABS, f"the table of scheme {scheme.name!r}", _ADVICE)
    numbers.normalise(classifier.largest())
    make = cell_table if scheme.place == "cell" else vertex_table
    table = make(classifier, backend, report)
    if key is not None:
        _keep(volume, key, table)
    return table


def _crowded(numbers: Any, needed: int, cells_per_step: float) -> bool:
    """Return True if the medium is better evaluated on the ray than for all cells beforehand.

    That is so where the rays visit few of the cells. But a table, if it can be recognised and
    leaves memory for other things, serves the next pictures too: of 512³ cells by 400² rays the
    first takes 3.1 s and the next 0.45 s, on the ray each takes 1.6 s.
    """
    if not fits(needed + _SLABS):
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


def _keep(volume: Any, key: Any, table: Table) -> None:
    """Remember a table; forget the oldest where there are many, or memory is short."""
    while volume.tables and (len(volume.tables) >= _KEPT or not fits(_SLABS)):
        volume.tables.popitem(last=False)
    volume.tables[key] = table


def _key(classifier: Classifier, scheme: Any) -> Any:
    """Return what a table depends on; None if that cannot be told.

    The fields' contents are hashed (at memory speed: 0.5 ms for 100³), since arrays are not copied
    and may have been changed in place.
    """
    own = classifier.numbers.key()
    if own is None:
        return None
    import xxhash

    volume, backend = classifier.volume, classifier.backend
    fields = tuple(
        (name, str(volume.field_unit(name)), xxhash.xxh3_64_digest(volume.array(name).data))
        for name in classifier.medium.names
        if name in volume
    )
    return (own, scheme.place, backend.device, backend.precision, fields)
