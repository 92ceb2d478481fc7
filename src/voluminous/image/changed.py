"""A picture like another, with some of what it holds replaced."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .planes import PLANES, gathered

if TYPE_CHECKING:
    from .image import Image


def changed(image: Image, **changes: Any) -> Image:
    """Return an image with other values of some arguments of `Image`; the rest stays.

    Parameters
    ----------
    image : Image
        It stays as it is, and shares its arrays.
    **changes
        Arguments of `Image`; planes that are given as None are left out.
    """
    names = ("intensity", "x", "y", "unit", "intensity_unit", "pixel_size", "wcs")
    known = {name: getattr(image, name) for name in (*names, "camera", "provenance")}
    beside = [name for name in PLANES if name not in changes]
    if image.waits_for_depth and "optical_depth" in beside:  # it takes a picture to compute
        beside.remove("optical_depth")
        known["optical_depth"] = lambda: plane(image, "optical_depth")
    known |= {name: plane(image, name) for name in beside}
    return type(image)(**{**known, **changes})


def plane(image: Image, name: str) -> Any:
    """Return one of the planes beside the intensity, without channels that are all the same."""
    found = getattr(image, name)
    return None if found is None else gathered(found)
