"""One axis of a grid, from the coordinate of a dimension: edges in ascending order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, UnitsError
from ..edges import edges_of_centers
from ..unit_texts import known_unit

if TYPE_CHECKING:
    import xarray

# Pressure grows downwards, whether or not its coordinate says so (CF conventions 4.3.1).
_PRESSURES = ("Pa", "hPa", "mbar", "dbar", "kPa", "bar")


@dataclass(frozen=True)
class Line:
    """One axis of a grid.

    Attributes
    ----------
    dim : str
        Its dimension.
    edges : array, shape (n + 1,)
        Of the cells, ascending; negative depths or pressures where `down`.
    unit : str
        Astropy's name, empty where there is none.
    flipped : bool
        True if values come in the opposite order.
    counted : bool
        True if there is no coordinate, and cells are counted.
    down : bool
        True if the coordinate grows downwards.
    """

    dim: str
    edges: np.ndarray
    unit: str = ""
    flipped: bool = False
    counted: bool = False
    down: bool = False

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.edges) - 1

    def described(self) -> dict[str, Any]:
        """Return name, unit and ends as plain values, as they are in the data."""
        ends = [float(self.edges[0]), float(self.edges[-1])]
        first, last = [-end for end in ends] if self.down else ends
        return {"name": self.dim, "unit": self.unit, "from": first, "to": last}


def line_of(data: xarray.Dataset, dim: str, upright: bool = False) -> Line:
    """Return the axis of a dimension.

    Parameters
    ----------
    data : Dataset
        Where the coordinate is, and its bounds if CF's attribute `bounds` names them.
    dim : str
        The dimension.
    upright : bool
        True for the z axis: what grows downwards is turned around, so that up is up.

    Raises
    ------
    InputError
        If the coordinate does not ascend or descend.
    """
    count = int(data.sizes[dim])
    if dim not in data.coords or data.coords[dim].dtype.kind not in "fiumM":
        return Line(dim, np.arange(count + 1.0), counted=True)
    coordinate = data.coords[dim]
    attributes = coordinate.attrs
    values, unit = _numbers(plain_values(coordinate), unit_in(coordinate))
    told = str(attributes.get("positive", "")).lower()
    down = upright and (told == "down" or (told != "up" and unit in _PRESSURES))
    sign = -1.0 if down else 1.0
    edges = _bounded(data, coordinate, sign, values)
    if edges is None:
        edges = edges_of_centers(_ascending(dim, sign * values))
    flipped = count > 1 and bool(sign * values[0] > sign * values[-1])
    return Line(dim, edges, unit, flipped, down=down)


def unit_in(array: xarray.DataArray) -> str:
    """Return the unit of an array, or of its attributes as far as astropy knows it.

    Raises
    ------
    UnitsError
        If the values are quantities (of pint, unyt, astropy …) in a unit that astropy lacks.
    """
    held = array.variable._data  # `data` would read a file
    own = str(getattr(held, "units", getattr(held, "unit", "")))
    if own not in ("", "dimensionless"):
        unit = known_unit(own)
        if not unit:
            raise UnitsError(f"{array.name} has values in {own!r}, which astropy does not know")
        return unit
    return known_unit(str(array.attrs.get("units", array.attrs.get("unit", ""))))


def plain_values(array: xarray.DataArray) -> np.ndarray:
    """Return the values without the unit that pint and others keep with them."""
    held = array.data
    return np.asarray(getattr(held, "magnitude", held))


def _numbers(values: np.ndarray, unit: str) -> tuple[np.ndarray, str]:
    if values.dtype.kind in "mM":
        return (values - values[0]) / np.timedelta64(1, "h"), "h"
    return values.astype(np.float64), unit


def _ascending(dim: str, values: np.ndarray) -> np.ndarray:
    ordered = values[::-1] if values[0] > values[-1] else values
    if not np.all(np.isfinite(values)) or np.any(np.diff(ordered) <= 0):
        raise InputError(
            f"the coordinate {dim!r} must ascend or descend strictly: sort the data with "
            f".sortby({dim!r}) or leave the coordinate out with .drop_vars({dim!r}) and count cells"
        )
    return ordered


def _bounded(
    data: xarray.Dataset, coordinate: xarray.DataArray, sign: float, centers: np.ndarray
) -> np.ndarray | None:
    """Return the edges that the bounds of cells tell, None where they do not join up."""
    name = coordinate.attrs.get("bounds") or coordinate.encoding.get("bounds")
    if name not in data.variables or data[name].shape != (len(centers), 2):
        return None
    pairs = data[name].values
    if pairs.dtype.kind not in "fiu":
        return None
    pairs = np.sort(sign * pairs.astype(np.float64), axis=1)
    pairs = pairs[::-1] if pairs[0, 0] > pairs[-1, 0] else pairs
    edges = np.append(pairs[:, 0], pairs[-1, 1])
    joined = np.allclose(pairs[1:, 0], pairs[:-1, 1], rtol=0, atol=1e-6 * np.ptp(edges))
    return edges if joined and np.all(np.diff(edges) > 0) else None
