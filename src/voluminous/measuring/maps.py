"""Maps: measurements per pixel, as images that know their units and where they are."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..image import Image
from ..rendering import image_wcs
from ..units import unit_name


def as_map(values: np.ndarray, unit: Any, volume: Any, camera: Any, told: dict[str, Any]) -> Image:
    """Return an image of some numbers per pixel.

    Parameters
    ----------
    values : array, shape (ny, nx) or (ny, nx, k)
    unit : astropy unit or None
    told : dict
        What was measured, and how: for the image's provenance. Its ``map`` says what the values
        are, in a colour bar too.
    """
    from .. import __version__

    frame = camera.frame(volume.grid)
    x, y = frame.coordinates()
    return Image(
        values,
        x=x,
        y=y,
        pixel_size=frame.pixel,
        unit=camera.plane_unit or unit_name(volume.unit),
        intensity_unit=unit_name(unit),
        camera=camera.describe(),
        wcs=image_wcs(volume, camera, frame),
        provenance={"software": f"voluminous {__version__}", "volume": volume.describe(), **told},
    )


def depth_map(values: np.ndarray, volume: Any, camera: Any, told: dict[str, Any]) -> Image:
    """Return an image of distances along the lines of sight."""
    return as_map(values, volume.unit, volume, camera, {**told, "map": "depth"})
