"""Things with a place in a picture: stars, spheres, lines, boxes and axes, at their true depth."""

from functools import partial
from typing import Any

from .boxes import Boxes
from .contract import SceneObject
from .curves import Axes, Curves
from .spheres import Spheres
from .stars import Stars

#: What ``type`` in a scene file's ``[[object]]`` may be.
OBJECTS: dict[str, Any] = {
    "stars": Stars,
    "spheres": Spheres,
    "curves": Curves,
    "lines": Curves,  # their name in older scenes
    # In a scene file there is but one volume.
    "boxes": partial(Boxes, None),
    "axes": partial(Axes, None),
}

__all__ = ["OBJECTS", "Axes", "Boxes", "Curves", "SceneObject", "Spheres", "Stars"]
