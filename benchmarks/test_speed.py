"""Time of `render` by scheme and precision, for pytest-benchmark (not part of the tests).

pytest -n 0 benchmarks/test_speed.py --benchmark-autosave --benchmark-compare
"""

from __future__ import annotations

import pytest

from our_scene import OurScene
from scenes import SCENES

SCHEMES = ("first-order", "second-order", "olson-kunasz")


@pytest.mark.parametrize("scene", list(SCENES))
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_render(benchmark, scheme, precision, scene):
    """Time the picture; compiling happens before, and is timed by startup.py."""
    contestant = OurScene(SCENES[scene], scheme, precision)
    benchmark.group = f"{scene}, {precision}"
    benchmark.pedantic(contestant.draw, rounds=15, warmup_rounds=1)
