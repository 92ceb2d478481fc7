"""Tests that every grid, scheme and camera must pass: inherit one, give the fixture it asks for.

For a grid::

    from contracts import GridContract


    class TestMyGrid(GridContract):
        @pytest.fixture
        def grid(self):
            return MyGrid(...)

        def locate(self, grid, points): ...
"""

from .bundle import Bundle, box_limits, chords, on_a_sphere
from .camera import CameraContract
from .grid import GridContract
from .reader import ReaderContract
from .scheme import SchemeContract

__all__ = [
    "Bundle",
    "CameraContract",
    "GridContract",
    "ReaderContract",
    "SchemeContract",
    "box_limits",
    "chords",
    "on_a_sphere",
]
