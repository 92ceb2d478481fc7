"""What OME-Zarr says of an image: its axes, its levels, and how large their voxels are.

Versions 0.4 and 0.5 of the specification, https://ngff.openmicroscopy.org; earlier ones have no
sizes of voxels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ...errors import FileFormatError
from ..channels import Channel, omero_channels
from ..unit_texts import known_unit

_OLD_AXES = ("t", "c", "z", "y", "x")


@dataclass(frozen=True)
class Level:
    """One resolution: where the array is, and per axis the size of a voxel and its first centre."""

    place: str
    scale: tuple[float, ...]
    translation: tuple[float, ...]


@dataclass(frozen=True)
class Multiscale:
    """An image in several resolutions, finest first.

    Attributes
    ----------
    axes : tuple of str
        ``t``, ``c``, ``z``, ``y``, ``x``, as far as they are there, in the arrays' order.
    unit : str
        Of x (astropy's name, empty where there is none).
    ratios : dict of str
        Unit of z, y and x over that of x.
    levels : tuple of Level
        The resolutions.
    channels : tuple of dict
        Labels, colours and windows, see `channels`.
    """

    axes: tuple[str, ...]
    unit: str
    ratios: dict[str, float]
    levels: tuple[Level, ...]
    channels: tuple[Channel, ...]


def multiscale_in(attributes: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the attributes that have ``multiscales``: version 0.5 has them in ``ome``."""
    inner = attributes.get("ome")
    for found in (inner, attributes):
        if isinstance(found, Mapping) and isinstance(found.get("multiscales"), list):
            return found
    return None


def parsed(attributes: Mapping[str, Any], place: str) -> Multiscale:
    """Return the first image that attributes describe.

    Parameters
    ----------
    attributes : mapping
        Those that `multiscale_in` finds.
    place : str
        Of their group.

    Raises
    ------
    FileFormatError
        If axes and levels do not fit together.
    """
    try:
        image = attributes["multiscales"][0]
        told = image.get("axes") or list(_OLD_AXES)
        axes = tuple(_axis_name(axis) for axis in told)
        units = {_axis_name(a): _axis_unit(a) for a in told}
        after = _transformed(image.get("coordinateTransformations"), len(axes), None)
        levels = tuple(_level(data, len(axes), after, place) for data in image["datasets"])
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise FileFormatError(
            f"the multiscales of {place or 'the image'} are not as OME-Zarr has them "
            f"({type(error).__name__}: {error})"
        ) from error
    if not levels or len(set(axes)) < len(axes) or not {"x", "y", "z"} <= set(axes):
        raise FileFormatError(f"expected an image with axes z, y and x, got {', '.join(axes)}")
    unit, ratios = _common_unit(units)
    return Multiscale(axes, unit, ratios, levels, omero_channels(attributes))


def _axis_name(axis: Any) -> str:
    return str(axis["name"] if isinstance(axis, Mapping) else axis).lower()


def _axis_unit(axis: Any) -> str:
    return known_unit(str(axis.get("unit", ""))) if isinstance(axis, Mapping) else ""


def _common_unit(units: Mapping[str, str]) -> tuple[str, dict[str, float]]:
    """Return the unit of x, and those of all axes over it; none where they do not convert."""
    from astropy import units as u

    try:
        own = u.Unit(units["x"])
        return units["x"], {axis: float(u.Unit(units[axis]).to(own)) for axis in "xyz"}
    except u.UnitsError:
        return "", dict.fromkeys("xyz", 1.0)


def _level(
    data: Mapping[str, Any], count: int, after: tuple[list[float], list[float]], place: str
) -> Level:
    scale, shift = _transformed(data.get("coordinateTransformations"), count, after)
    path = str(data["path"]).strip("/")
    return Level(f"{place}/{path}" if place else path, tuple(scale), tuple(shift))


def _transformed(
    steps: Any, count: int, after: tuple[list[float], list[float]] | None
) -> tuple[list[float], list[float]]:
    """Return scale and translation of steps one after the other, then of those `after` them."""
    scale, shift = [1.0] * count, [0.0] * count
    for step in steps or []:
        kind = step["type"]
        if kind == "scale":
            factors = _numbers(step["scale"], count)
            scale = [s * f for s, f in zip(scale, factors, strict=True)]
            shift = [s * f for s, f in zip(shift, factors, strict=True)]
        elif kind == "translation":
            moved = _numbers(step["translation"], count)
            shift = [s + m for s, m in zip(shift, moved, strict=True)]
        elif kind != "identity":
            raise ValueError(f"unknown transformation {kind!r}")
    if after is not None:
        shift = [s * f + m for s, f, m in zip(shift, *after, strict=True)]
        scale = [s * f for s, f in zip(scale, after[0], strict=True)]
    return scale, shift


def _numbers(values: Sequence[Any], count: int) -> list[float]:
    if len(values) != count:
        raise ValueError(f"expected {count} numbers, got {len(values)}")
    return [float(value) for value in values]
