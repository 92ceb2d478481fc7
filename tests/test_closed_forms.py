"""Media whose pictures are known: slabs, spheres, cubes; and the contract of the schemes."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from contracts import SchemeContract, chords
from contracts.camera import rays_of
from voluminous.schemes import SCHEMES

# Rounding of a handful of operations; single precision tells 6e-8 apart.
ROUNDING = {"single": 1e-6, "double": 1e-14}
DEPTHS = [1e-12, 1e-9, 1e-7, 1e-6, 1e-4, 0.01, 0.02, 0.3, 0.5, 0.7, 1.0, 18.0, 40.0, 1e2, 1e4]
ALONG_Z = vm.Orthographic(width=0.5, resolution=1)


class TestFirstOrder(SchemeContract):
    @pytest.fixture
    def scheme(self):
        return "first-order"


class TestSecondOrder(SchemeContract):
    @pytest.fixture
    def scheme(self):
        return "second-order"


class TestOlsonKunasz(SchemeContract):
    # For τ > 1e-6 it takes the difference of nearly equal numbers: 1e-16/τ² is lost, and more
    # still below, where the transparency is 1 - τ.
    rounding = 1e-6

    @pytest.fixture
    def scheme(self):
        return "olson-kunasz"


def slab(scheme, precision, j, alpha, background=0.0):
    """Return intensity, transparency and optical depth of a slab of thickness one."""
    volume = vm.models.uniform_slab(j, alpha)
    image = vm.render(
        volume,
        vm.Coefficients("j", "a"),
        ALONG_Z,
        scheme=scheme,
        precision=precision,
        background=background,
        cutoff=0,
    )
    return image.intensity.item(), image.transparency.item(), image.optical_depth.item()


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("scheme", ["first-order", "second-order"])
def test_uniform_slab_at_every_depth(scheme, precision):
    for tau in DEPTHS:
        intensity, transparency, depth = slab(scheme, precision, 0.5, tau, background=3.0)
        exact = 0.5 * -np.expm1(-tau) / tau + 3.0 * np.exp(-tau)
        assert depth == pytest.approx(tau, rel=ROUNDING[precision])
        assert intensity == pytest.approx(exact, rel=ROUNDING[precision])
        # An error of τ is one of exp(-τ) times τ. What is less than 1e-30 is nothing.
        tolerance = ROUNDING[precision] * max(tau, 1.0)
        assert transparency == pytest.approx(np.exp(-tau), rel=tolerance, abs=1e-30)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("scheme", sorted(SCHEMES))
def test_pure_emitter_and_pure_absorber(scheme, precision):
    assert slab(scheme, precision, 0.5, 0.0) == pytest.approx((0.5, 1, 0), rel=ROUNDING[precision])
    assert slab(scheme, precision, 0.5, 0.0, background=2.0)[0] == pytest.approx(2.5)
    dark = slab(scheme, precision, 0.0, 2.0, background=5.0)
    expected = (5 * np.exp(-2), np.exp(-2), 2)
    assert dark == pytest.approx(expected, rel=ROUNDING[precision])
    assert slab(scheme, precision, 0.0, 0.0, background=5.0) == (5.0, 1.0, 0.0)


def test_backgrounds_are_numbers_channels_or_pictures():
    volume, camera = vm.models.uniform_slab(1.0, 2.0), vm.Orthographic(width=2, resolution=(5, 4))
    medium = vm.Coefficients(["j", "0*j"], "a")
    dark = vm.render(volume, medium, camera, precision="double")
    picture = np.random.default_rng(0).uniform(size=(4, 5, 2))
    backgrounds = [3.0, [1.0, 2.0], picture[..., 0], picture[..., :1], picture, vm.Image(picture)]
    shapes = [3.0, [1.0, 2.0], picture[..., :1], picture[..., :1], picture, picture]
    for background, light in zip(backgrounds, shapes, strict=True):
        lit = vm.render(volume, medium, camera, precision="double", background=background)
        # Also beside the slab, where nothing is in the way.
        expected = dark.intensity + dark.transparency * light
        np.testing.assert_allclose(lit.intensity, expected, rtol=1e-15)
    assert dark.transparency.max() == 1


@pytest.mark.parametrize("scheme", sorted(SCHEMES))
def test_sphere_is_round_to_the_size_of_a_cell(scheme):
    volume = vm.models.sphere(48, radius=1.0)
    camera = vm.Orthographic(35, 20, width=2.5, resolution=25)
    image = vm.render(volume, vm.Coefficients("inside", "2*inside"), camera, scheme=scheme)
    b2 = image.x[None, :] ** 2 + image.y[:, None] ** 2
    chord = 2 * np.sqrt(np.maximum(1 - b2, 0))
    exact = 0.5 * -np.expm1(-2 * chord)
    cell = 2.5 / 48
    # A wall of cells is within a cell's diagonal of the sphere, on average within a part of it;
    # the chord changes by the distance over the cosine of incidence.
    inner = b2 < 0.8**2
    off = np.abs(image.optical_depth[..., 0] / 2 - chord)
    assert off[inner].max() < 4 * cell
    assert off.mean() < cell
    assert np.abs(image.intensity[..., 0] - exact)[inner].max() < 4 * cell


VIEWS = {
    "face": ((0, 0), 1.0, 1.0),
    "face x": ((90, 90), 1.0, 1.0),
    "face y": ((90, 0), 1.0, 1.0),
    "face from below": ((180, 0), 1.0, 1.0),
    "edge": ((45, 0), np.sqrt(2), np.sqrt(2)),
    "edge x": ((45, 90), np.sqrt(2), np.sqrt(2)),
    "edge xy": ((90, 45), np.sqrt(2), np.sqrt(2)),
    "corner": ((np.degrees(np.arccos(1 / np.sqrt(3))), 45), np.sqrt(3), np.sqrt(3)),
    "corner below": ((180 - np.degrees(np.arccos(1 / np.sqrt(3))), 225), np.sqrt(3), np.sqrt(3)),
}


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("view", sorted(VIEWS))
def test_cube_seen_along_every_symmetry(view, precision):
    (incl, phi), area, path = VIEWS[view]
    grid = vm.CartesianGrid.uniform(4, (-0.5, 0.5))
    volume = vm.Volume(grid, a=np.ones(grid.shape))
    camera = vm.Orthographic(incl, phi, width=2, resolution=101)
    image = vm.render(
        volume, vm.Coefficients("0", "a"), camera, scheme="first-order", precision=precision
    )
    depth = image.optical_depth[..., 0].ravel()
    rounding = 1e-6 if precision == "single" else 1e-13
    assert depth[len(depth) // 2] == pytest.approx(path, rel=rounding)
    exact = chords(grid.bounds, *rays_of(camera, grid))
    np.testing.assert_allclose(depth, exact, rtol=0, atol=4 * rounding)
    # A pixel belongs to the silhouette if its centre does: right to half a pixel along the sides.
    sides = 6 * 1.0 * image.pixel_size[0]
    assert np.count_nonzero(depth) * image.pixel_area == pytest.approx(area, abs=0.5 * sides)
