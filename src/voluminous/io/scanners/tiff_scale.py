"""How large the voxels of a TIFF stack are: in OME's XML, or in ImageJ's notes."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

from .lengths import conversion, length_unit

_RESOLUTIONS = ("XResolution", "YResolution")


def scale_of(file: Any) -> tuple[tuple[float, ...], str]:
    """Return the widths of voxels along x, y, z and their unit; (1, 1, 1) where it is not told.

    Parameters
    ----------
    file : tifffile.TiffFile
        Open.
    """
    if file.is_ome and file.ome_metadata:
        return _ome(file.ome_metadata)
    if file.is_imagej and file.imagej_metadata:
        return _imagej(file)
    # Other files tell the size of paper at best.
    return (1.0, 1.0, 1.0), ""


def _ome(text: str) -> tuple[tuple[float, ...], str]:
    pixels = next(
        (e.attrib for e in ElementTree.fromstring(text).iter() if e.tag.endswith("}Pixels")), {}
    )
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
