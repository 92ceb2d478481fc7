"""Films: paths of cameras, media that fade, series of volumes, and files."""

from .film import movie
from .frame import fade
from .paths import dolly, fly, keyframes, orbit, zoom

__all__ = ["dolly", "fade", "fly", "keyframes", "movie", "orbit", "zoom"]
