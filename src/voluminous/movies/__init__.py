"""Films: paths of cameras, media that fade, series of volumes, and files."""

from .fade import fade
from .film import movie
from .paths import dolly, fly, keyframes, orbit, zoom

__all__ = ["dolly", "fade", "fly", "keyframes", "movie", "orbit", "zoom"]
