"""Media of physics: dust, lines and free-free emission at frequencies (`observing` draws them)."""

from .dust import Dust
from .free_free import FreeFree
from .lines import Lines
from .medium import SpectralMedium

__all__ = ["Dust", "FreeFree", "Lines", "SpectralMedium"]
