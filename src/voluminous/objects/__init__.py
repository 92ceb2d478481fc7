"""Things with a place in a picture: stars, spheres, lines, boxes and axes, at their true depth."""

from functools import partial
from typing import Any

from .boxes import boxes
from .contract import SceneObject
from .lines import Lines, axes
from .spheres import Spheres
from .stars import Star, Stars

#: What ``type`` in a scene file's ``[[object]]`` may be.
OBJECTS: dict[str, Any] = {
    "star": Star,
    "stars": Stars,
    "spheres": Spheres,
    "lines": Lines,
    # In a scene file there is but one volume.
    "boxes": partial(boxes, None),
    "axes": partial(axes, None),
}

__all__ = ["OBJECTS", "Lines", "SceneObject", "Spheres", "Star", "Stars", "axes", "boxes"]
