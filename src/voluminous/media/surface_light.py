"""How a surface lies in the light of a ray: the angles between its normal and the ray."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..backend import dr

if TYPE_CHECKING:
    from .context import Context
    from .stretch import Panel, Stretch


def obliquity(slope: Any, rise: Any, turned: Any, panel: Panel, context: Context) -> Any:
    """Return |∇x| over |∂x/∂s|, at least one.

    Parameters
    ----------
    slope : array
        |∇x| per length of the grid's scale.
    rise : array
        What x changes by over the panel.
    turned : array
        Its mean slope over the slope at the place.
    """
    way = dr.abs(rise)
    ratio = panel.length * turned * context.narrow(slope / dr.select(way > 0.0, way, 1.0))
    return dr.select(ratio > 1.0, ratio, 1.0)


def lambert(normal: list[Any], stretch: Stretch, place: Any, context: Context) -> Any:
    """Return the cosine of ray and normal at a place in a stretch; one if there is no normal.

    Parameters
    ----------
    normal : list of three Expression
        The components of the gradient.
    """
    fields = stretch.fields(place)
    across = _scaled([context.evaluate(e, fields) for e in normal], context)
    way = _scaled([stretch.cubics[axis][1] for axis in "xyz"], context)
    size = dr.sqrt(_dot(across, across) * _dot(way, way))
    cosine = dr.abs(_dot(across, way)) / dr.select(size > 0.0, size, 1.0)
    return dr.select(size > 0.0, cosine, 1.0)


def _scaled(vector: list[Any], context: Context) -> list[Any]:
    """Return a vector over its largest component: squares of gradients in g/cm⁴ underflow."""
    x, y, z = (dr.abs(v) for v in vector)
    most = dr.maximum(x, dr.maximum(y, z))
    return [context.narrow(v / dr.select(most > 0.0, most, 1.0)) for v in vector]


def _dot(a: list[Any], b: list[Any]) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
