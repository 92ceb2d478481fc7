"""Voxels and channels of a TIFF stack, as OME's XML or ImageJ's notes give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..channels import Channel, channel
from .lengths import conversion, length_unit

_RESOLUTIONS = ("XResolution", "YResolution")


def scale_of(file: Any, number: int) -> tuple[tuple[float, ...], str]:
    """Return the widths of voxels along x, y, z and their unit; (1, 1, 1) where it is not told.

    Parameters
    ----------
    file : tifffile.TiffFile
        Open.
    number : int
        Of the series.
    """
    if file.is_ome and file.ome_metadata:
        return _ome(_pixels(file, number))
    if file.is_imagej and file.imagej_metadata:
        return _imagej(file)
    # Other files tell the size of paper at best.
    return (1.0, 1.0, 1.0), ""


def channels_of(file: Any, number: int, count: int) -> list[Channel]:
    """Return the entries of so many channels of a series, empty where the file gives nothing."""
    listed = []
    if file.is_ome and file.ome_metadata:
        listed = [_ome_channel(e.attrib) for e in _pixels(file, number) if _tag(e) == "Channel"]
    elif file.is_imagej and file.imagej_metadata:
        listed = _imagej_channels(file.imagej_metadata, count)
    return (listed + [{}] * count)[:count]


def _pixels(file: Any, number: int) -> ElementTree.Element:
    """Return OME's description of a series, which are in the order of the images."""
    root = ElementTree.fromstring(file.ome_metadata)
    found = [e for e in root.iter() if _tag(e) == "Pixels"]
    return found[number] if number < len(found) else ElementTree.Element("Pixels")


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rsplit("}", 1)[-1]


def _ome_channel(told: Mapping[str, str]) -> Channel:
    try:
        color = list((int(told["Color"]) % 2**32).to_bytes(4, "big")[:3])
    except (KeyError, ValueError):
        color = None
    return channel(told.get("Name") or told.get("Fluor"), color)


def _imagej_channels(notes: Mapping[str, Any], count: int) -> list[Channel]:
    """Return colours, of tables that go from black to one colour evenly, and display ranges."""
    tables, ends = notes.get("LUTs") or [], list(notes.get("Ranges") or [])
    if not ends and count == 1 and {"min", "max"} <= set(notes):
        ends = [notes["min"], notes["max"]]
    entries = []
    for k in range(count):
        color = None
        table = np.asarray(tables[k], float) if k < len(tables) else np.empty(0)
        if table.shape == (3, 256):
            ramp = table[:, -1:] * np.linspace(0, 1, 256)
            color = table[:, -1] if np.abs(table - ramp).max() <= 2 else None
        entries.append(channel("", color, ends[2 * k : 2 * k + 2]))
    return entries


def _ome(element: ElementTree.Element) -> tuple[tuple[float, ...], str]:
    pixels = element.attrib
    sizes = [pixels.get(f"PhysicalSize{axis}") for axis in "XYZ"]
    if not any(sizes):
        return (1.0, 1.0, 1.0), ""
    units = [length_unit(pixels.get(f"PhysicalSize{axis}Unit", "um")) for axis in "XYZ"]
    widths = [
        float(size) * conversion(unit, units[0]) if size else None
        for size, unit in zip(sizes, units, strict=True)
    ]
    known = [width for width in widths if width]
    # Of what is not told it is most likely that voxels are cubes.
    return tuple(width or known[0] for width in widths), units[0]


def _imagej(file: Any) -> tuple[tuple[float, ...], str]:
    notes, tags = file.imagej_metadata, file.pages.first.tags
    unit = length_unit(str(notes.get("unit", "")))
    widths = []
    for name in _RESOLUTIONS:
        over, under = tags.valueof(name, (1, 1))
        # Without a unit of length resolutions are what a printer is to do.
        widths.append(under / over if unit and over and under else 1.0)
    depth = float(notes.get("spacing", 0)) if unit or "spacing" in notes else 0.0
    return (*widths, abs(depth) or widths[0]), unit
