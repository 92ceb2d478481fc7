"""The order in which the rays of a picture are put into vectors."""

from __future__ import annotations

import numpy as np
import pytest

from voluminous.backend import get_backend
from voluminous.rendering.pixels import TILE, PixelOrder

NOBODY = 0xFFFFFFFF


@pytest.mark.parametrize("blocks", [1, 3, 1000])
@pytest.mark.parametrize("pixels", [(1, 1), (16, 16), (17, 5), (33, 170), (250, 31)])
def test_every_pixel_is_one_lane_in_batches_of_any_size(pixels, blocks):
    nx, ny = pixels
    order, backend = PixelOrder(pixels), get_backend("cpu", "single")
    found = []
    for first in range(0, order.count, blocks * TILE**2):
        lanes = order.lanes(first, min(blocks * TILE**2, order.count - first), backend)
        target = np.array(lanes.target)
        there = target != NOBODY
        row, column = np.divmod(target[there], nx)
        np.testing.assert_array_equal(np.array(lanes.u)[there], column - 0.5 * (nx - 1))
        np.testing.assert_array_equal(np.array(lanes.v)[there], row - 0.5 * (ny - 1))
        found.append(target[there])
    np.testing.assert_array_equal(np.sort(np.concatenate(found)), np.arange(nx * ny))


@pytest.mark.parametrize("pixels", [(400, 400), (640, 160)])
def test_blocks_run_outwards_from_the_middle(pixels):
    order = PixelOrder(pixels)
    row, column = np.divmod(order.outwards, order.columns)
    middle = [0.5 * (n - 1) for n in (order.columns, order.rows)]
    ring = np.maximum(np.abs(column - middle[0]), np.abs(row - middle[1]))
    assert (np.diff(np.floor(ring)) >= 0).all()
    np.testing.assert_array_equal(np.sort(order.outwards), np.arange(order.columns * order.rows))
