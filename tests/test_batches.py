"""A picture in batches of limited time: any order, partial results, and to cancel is to stop."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from voluminous.drawing.api import in_steps
from voluminous.rendering.options import RenderOptions

VOLUME = vm.Volume(
    vm.CartesianGrid.uniform(24, (-1, 1)), a=np.random.default_rng(0).random((24, 24, 24))
)
MEDIUM = vm.Gaussian("a", 0.5, 0.1, (1, 0.5, 0.1), 0.5, 0.1)
CAMERA = vm.Orthographic(60, 30, resolution=(200, 150))
OPTIONS = {
    "default": {},
    "pre-integrated": {"tolerance": None},
    "first-order": {"scheme": "first-order"},
    "four rays": {"scheme": "first-order", "samples": 2},
    "not adaptive": {"scheme": "first-order", "antialias": "radmc3d"},
}


@pytest.mark.parametrize("name", OPTIONS)
def test_batches_add_up_to_the_picture(name):
    intensity = np.full((200 * 150, 3), np.nan, np.float32)
    transparency = np.full((200 * 150, 1), np.nan, np.float32)
    count = 0
    for pixel, light, through in in_steps(
        VOLUME, MEDIUM, CAMERA, RenderOptions(**OPTIONS[name]), seconds=0.005, focus=(20, 130)
    ):
        intensity[pixel], transparency[pixel] = light, through
        if name == "first-order" and not count:
            rows, columns = np.divmod(pixel, 200)
            assert abs(np.median(columns) - 20) < 60
            assert abs(np.median(rows) - 130) < 60
        count += 1
    assert count > 1
    image = vm.render(VOLUME, MEDIUM, CAMERA, **OPTIONS[name])
    if "samples" not in OPTIONS[name]:  # each batch holds one ray per pixel
        np.testing.assert_array_equal(intensity.reshape(150, 200, 3), image.intensity)
        np.testing.assert_array_equal(
            transparency.reshape(150, 200, 1), image.transparency[..., :1]
        )


def test_a_picture_is_cancelled_by_asking_no_more():
    next(in_steps(VOLUME, MEDIUM, CAMERA, RenderOptions(), seconds=0.001))
    image, again = (vm.render(VOLUME, MEDIUM, CAMERA) for _ in range(2))
    np.testing.assert_array_equal(image.intensity, again.intensity)
