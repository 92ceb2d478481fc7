"""Large fields are gathered in place, small integers from words: the same pictures as of copies."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm

# More than 2^25 cells, so that there are no quads, and small integers are packed in words; a number
# of octets that is not one of whole words.
SHAPE = (323, 321, 325)


@pytest.fixture(scope="module")
def volumes():
    """The same numbers as integers of one and two octets, and as floating point."""
    x, y, z = (np.linspace(-1, 1, n, dtype=np.float32) for n in SHAPE)
    radius = np.sqrt(x[:, None, None] ** 2 + y[:, None] ** 2 + z**2)
    values = (radius * 70).astype(np.int16)
    values[:3], values[-2:], values[:, :, -1] = 20, 40, 60  # the outermost cells count
    grid = vm.CartesianGrid.uniform(SHAPE, ((-1, 1),) * 3)
    kinds = {"u1": values.astype(np.uint8), "i2": -values, "f4": values.astype(np.float32)}
    return {kind: vm.Volume(grid, a=array) for kind, array in kinds.items()}


@pytest.mark.parametrize("scheme", [None, "first-order"])
def test_integers_are_the_same_numbers(volumes, scheme):
    camera = vm.Orthographic(60, 30, width=3.2, resolution=24)
    images = {}
    for kind, volume in volumes.items():
        medium = vm.Gaussian("abs(a)", 45.0, 4.0, (1, 0.5, 0.2), 0.3, 0.1)
        images[kind] = vm.render(volume, medium, camera, scheme=scheme)
    reference = images["f4"].intensity
    assert reference.max() > 0.5
    for kind in ("u1", "i2"):
        np.testing.assert_allclose(images[kind].intensity, reference, atol=2e-6)


def test_in_place_is_as_in_blocks_of_copies(volumes):
    """Blocks of chunks have a rim of their own, which repeats the outermost cells."""
    camera = vm.Orthographic(60, 30, width=3.2, resolution=24)
    medium = vm.Gaussian("a", 45.0, 4.0, (1, 0.5, 0.2), 0.3, 0.1)
    whole = vm.render(volumes["f4"], medium, camera)
    blocks = vm.render(volumes["f4"], medium, camera, memory="1 GiB")
    np.testing.assert_allclose(whole.intensity, blocks.intensity, atol=1e-3 * whole.intensity.max())
    assert np.abs(whole.intensity - blocks.intensity).max() < 1e-4
