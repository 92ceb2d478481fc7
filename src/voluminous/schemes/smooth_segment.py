"""A segment on which the medium is smooth: the means of a few nodes, and a bound of their error.

Where shells are wider than cells most segments need no more, and take a quarter of the time of
three panels that are compared.
"""

from __future__ import annotations

from typing import Any

from ..backend.functions import THIN, thin_attenuation
from ..media.at_nodes import mean
from .path import Path, most


def smooth_segment(source: Any, whole: Any, seen_through: Any, backward: bool) -> tuple[Path, Any]:
    """Return a segment solved with means of nodes, and where that is good enough.

    Parameters
    ----------
    source, whole
        Where coefficients are from, and the segment's stretch.
    seen_through : array
        Transparency of what is in front.
    backward : bool
        The walk goes towards the observer.
    """
    *nodes, (off, off_depth) = source.at_nodes(whole)
    length = whole.length
    (j_first, a_first), *_, (j_last, a_last) = nodes
    emissivity, extinction = (
        [mean(own) for own in zip(*(node[k] for node in nodes), strict=True)] for k in (0, 1)
    )
    depth = [a * length for a in extinction]
    found = [thin_attenuation(tau) for tau in depth]
    ahead = (-1.0 if backward else 1.0) / 12.0 * length * length
    emission, order = [], []
    for c, j in enumerate(emissivity):
        k = c if len(found) > 1 else 0
        turn = ahead * (j_first[c] * a_last[k] - j_last[c] * a_first[k])
        emission.append(j * length * found[k][1] + turn)
        order.append(turn)
    brightness = source.numbers.brightness
    bright = brightness(emission)
    dim = most(off_depth) * length
    wrong = brightness(off) * length + 0.5 * (dim * bright + brightness(order))
    allowed, allowed_dim = source.tolerance
    good = (seen_through * wrong <= allowed) & (seen_through * dim <= allowed_dim)
    path = Path(emission, [theta for theta, _ in found], depth, [wrong, dim, bright])
    return path, good & (most(depth) <= THIN)
