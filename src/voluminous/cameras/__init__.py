"""Which rays a picture is made of: one file per camera, one contract (`cameras.contract`)."""

from .contract import Camera, Frame
from .orthographic import Orthographic
from .panorama import Panorama
from .perspective import Perspective

CAMERAS = {"orthographic": Orthographic, "perspective": Perspective, "panorama": Panorama}

__all__ = ["CAMERAS", "Camera", "Frame", "Orthographic", "Panorama", "Perspective"]
