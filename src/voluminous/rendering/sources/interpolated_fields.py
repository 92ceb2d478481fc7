"""Fields interpolated on the ray, and what of a medium may be left out of a picture there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...backend import dr
from ..cache import Cache
from ..coefficients.classify import Classifier
from ..coefficients.digits import Exactness, exactness
from ..coefficients.own_coordinates import ray_coordinates
from ..empty_space.blocks import DUAL
from ..empty_space.pruned import can_be_pruned, interpolated, pruned_walk
from ..interpolants.interpolated import Interpolated
from .kept import get_blocks, get_lattices

# The least that a precision can tell of a peak.
_FAINTEST = {"single": 1e-37, "double": 1e-300}
# Rays that pass along a shell where it is faint do so for some path lengths at least. For more than
# the second number nothing need be known: the faintest part of a peak is of a width as before.
_SOME_PATHS, _MOST_PATHS = 10.0, 1e12
# What pictures on curvilinear grids are off by, of the tolerance: nearly all of them by less.
_LOST_BY_CUBICS = 0.1
# What places lose, in ε: seen of a shell with σ = 1e-4 dex in a field of 3 dex, and at most.
_LOST_PER_EPS, _MOST_LOST = 0.1, 1e-3


def interpolated_fields(
    classifier: Classifier,
    cache: Cache,
    scheme: Any,
    tolerance: float,
    faintest: bool,
    whole: bool,
) -> Interpolated:
    """Return the medium on interpolated fields; their lattices are kept with the volume."""
    volume, backend = classifier.volume, classifier.backend
    needed = _remember(classifier, cache)
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
        tolerance=tolerance,
        coordinates=ray_coordinates(volume, classifier.medium.names),
    )
    blocks = get_blocks(classifier, cache, faint, DUAL, scheme.coarseness if whole else 0.0)
    lattices = get_lattices(classifier, cache, blocks)
    source = Interpolated(classifier, lattices, context, blocks, paths)
    if whole:
        source.walk = _pruned(classifier, cache, lattices, faint)
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
    if walk.approximate:
        source.walk = walk.kept_to(tolerance / contrast)
        source.lost += _LOST_BY_CUBICS * tolerance


def _path_lengths(classifier: Classifier) -> float:
    """Return how many path lengths a ray may follow a shell for: some, or all the way across."""
    grid, largest = classifier.grid, classifier.largest()
    diagonal = float(np.linalg.norm(np.ptp(grid.bounds, axis=1))) / grid.scale
    return float(np.clip(classifier.numbers.paths(largest) * diagonal, _SOME_PATHS, _MOST_PATHS))


def _pruned(classifier: Classifier, cache: Cache, lattices: dict[str, Any], faint: float) -> Any:
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
    return cache.get_or_make(
        ("pruned", own, faint, cache.statistics.digests(medium.names), backend), make
    )


def _remember(classifier: Classifier, cache: Cache) -> Exactness:
    """Have what was found for the same medium before, and return how exact expressions must be."""
    own = classifier.medium.key()

    def make() -> tuple[list[float], Exactness]:
        return classifier.largest(), exactness(classifier)

    if own is None:
        return make()[1]
    # Shapes have other numbers than what is made of all their colours.
    kind = type(classifier.numbers).__name__
    key = ("numbers", kind, own, cache.statistics.digests(classifier.medium.names))
    found: tuple[list[float], Exactness] = cache.get_or_make(key, make)
    classifier.expect(found[0])
    return found[1]


def _limits(classifier: Classifier, real: Any) -> dict[str, tuple[Any, Any]]:
    """Return the least and largest values of all fields, as numbers of a kernel."""
    volume = classifier.volume
    extremes = {
        n: classifier.statistics.extremes(n) for n in classifier.medium.names if n in volume
    }
    return {
        name: (dr.opaque(real, low), dr.opaque(real, high))
        for name, (low, high) in extremes.items()
    }
