"""A new grid is one file: the Voronoi grid of the examples, with every verb of the package."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

import voluminous as vm
from contracts import GridContract
from voluminous.errors import InputError

EXAMPLE = Path(__file__).parents[1] / "examples" / "voronoi_grid.py"
BOUNDS = np.array([(-1.0, 1.0), (-0.8, 0.9), (-1.1, 1.0)])


def example():
    spec = importlib.util.spec_from_file_location("voronoi_grid", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    sys.modules["voronoi_grid"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


VoronoiGrid = example().VoronoiGrid


def random_grid(count=200, seed=3):
    points = np.random.default_rng(seed).uniform(*BOUNDS.T, size=(count, 3))
    points[: count // 2] = 0.3 * points[: count // 2] ** 3  # many of them close together
    return VoronoiGrid(points, BOUNDS)


def nearest(grid, points):
    return np.array([np.argmin(np.sum((grid.points - p) ** 2, axis=1)) for p in points])


class TestVoronoiGrid(GridContract):
    @pytest.fixture
    def grid(self):
        return random_grid()

    def locate(self, grid, points):
        return nearest(grid, points)

    test_corners_are_an_interpolation = None  # it has no vertices
    test_values_are_continuous_from_cell_to_cell = None


@pytest.fixture(scope="module")
def volume():
    grid = random_grid()
    density = np.random.default_rng(1).uniform(0.1, 1, grid.size)
    return vm.Volume(grid, density=density, speed=density**2)


CAMERA = vm.Orthographic(35, 50, width=3, resolution=24)
MEDIUM = vm.Coefficients("density", "density / 2")


def test_volumes_fill_the_box(volume):
    grid = volume.grid
    assert grid.cell_volumes.sum() == pytest.approx(np.prod(np.ptp(BOUNDS, axis=1)), rel=1e-12)
    sample = np.random.default_rng(2).uniform(*BOUNDS.T, size=(20_000, 3))
    share = np.bincount(grid.locate(sample), minlength=grid.size) / len(sample)
    expected = grid.cell_volumes / grid.cell_volumes.sum()
    np.testing.assert_allclose(share, expected, atol=6 * np.sqrt(expected.max() / len(sample)))


def test_columns_are_brute_force(volume):
    image = vm.column(volume, "density", CAMERA, precision="double")
    grid, frame = volume.grid, CAMERA.frame(volume.grid)
    center, right, up, into = frame.vectors[:4]
    x, y = frame.coordinates()
    s = np.linspace(-3, 3, 60_001)
    for ix, iy in ((12, 12), (7, 15), (16, 9)):
        points = center + x[ix] * right + y[iy] * up + s[:, None] * into
        cell = grid.locate(points)
        values = np.where(cell >= 0, volume.array("density")[cell], 0.0)
        expected = values.sum() * (s[1] - s[0])
        assert image.intensity[iy, ix].item() == pytest.approx(expected, abs=3e-4)


def test_verbs_that_work(volume):
    image = vm.render(volume, MEDIUM, CAMERA, scheme="first-order")
    assert image.intensity.max() > 0
    inside = vm.Perspective((0.1, 0.05, 0.02), (1, 1, 0.3), 80, resolution=16)
    assert vm.render(volume, MEDIUM, inside, scheme="first-order").intensity.min() > 0
    assert vm.render(volume, scheme="first-order").intensity.max() > 0
    total = vm.measure(volume, "density")
    assert "200 cells" in str(total)
    resampled = volume.resample(vm.CartesianGrid.uniform(4, BOUNDS))
    expected = np.average(volume.array("density"), weights=volume.grid.cell_volumes)
    assert resampled.array("density").mean() == pytest.approx(expected, rel=0.02)
    assert np.isfinite(volume.slice("density", resolution=16).values).all()
    assert vm.probe(volume, MEDIUM, CAMERA, (12, 12), scheme="first-order") is not None


def test_verbs_that_are_refused_in_words(volume, tmp_path):
    box = vm.grids.contract.CellBox((0,) * 3, (1,) * 3)
    refused = {
        "scheme='first-order'": lambda: vm.render(volume, MEDIUM, CAMERA),
        "second-order": lambda: vm.render(volume, MEDIUM, CAMERA, scheme="second-order"),
        "bounds": lambda: vm.render(volume, MEDIUM, CAMERA, scheme="first-order", bounds=True),
        "cells that are boxes": lambda: vm.column(volume, "density", CAMERA, method="exact"),
        "needs cells that are boxes": lambda: volume.evaluate("gradmag(density)"),
        "clip= needs cells that are boxes": lambda: vm.measure(
            volume, "density", clip=vm.regions.Sphere((0, 0, 0), 0.5)
        ),
        "native file": lambda: volume.save(tmp_path / "cells.h5"),
        "cannot be resampled onto": lambda: volume.resample(volume.grid),
        "confined": lambda: volume.grid.walk(vm.backend.get_backend("cpu", "single"), box=box),
    }
    for words, verb in refused.items():
        with pytest.raises(InputError, match=words):
            verb()
