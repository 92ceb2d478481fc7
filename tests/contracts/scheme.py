"""What every scheme must do."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from contracts.bundle import Bundle, on_a_sphere
from voluminous.schemes import get_scheme
from voluminous.schemes.base import TowardsObserver

EDGES = ([-1.0, -0.3, 0.1, 0.8, 2.0], [0.0, 0.5, 0.75, 3.0], [-2.0, -1.0, 1.0])
INSIDE = (0.2, 0.9, -0.4)


def random_volume(seed=0, depth=1.0, edges=EDGES):
    """Return two channels of noise; `depth` is the mean optical depth of a cell."""
    grid, rng = vm.CartesianGrid(*edges), np.random.default_rng(seed)
    names = ("j0", "j1", "a0", "a1")
    fields = {name: rng.uniform(size=grid.shape) for name in names}
    return vm.Volume(grid, {k: 2 * depth * v if k[0] == "a" else v for k, v in fields.items()})


def coloured():
    """Return a medium with an extinction for each of two channels."""
    return vm.Coefficients(["j0", "j1"], ["a0", "a1"])


def lines(count=64, *, start=False):
    """Return rays through (or, with `start`, from) a point inside, in all directions."""
    directions = on_a_sphere(count, seed=5)
    return Bundle(np.array(INSIDE) - (0 if start else 9) * directions, directions, start=start)


def both_ways(scheme):
    """Return a scheme of cells or vertices twice: its rays run from the observer, and to it."""
    return [get_scheme(scheme), TowardsObserver(get_scheme(scheme))]


class SchemeContract:
    """A uniform medium is solved exactly, directions and media compose, nothing overflows.

    A subclass gives the fixture ``scheme`` (a name or an object), and `rounding` where the scheme
    loses digits by its definition.
    """

    rounding = 1e-13

    def render(self, scheme, volume, medium=None, camera=None, **options):
        """Render in double precision, without a cut-off."""
        options = {"precision": "double", "cutoff": 0, **options}
        return vm.render(volume, medium or coloured(), camera or lines(), scheme=scheme, **options)

    def test_it_says_what_it_is(self, scheme):
        found = get_scheme(scheme)
        assert found.name
        assert found.order >= 1
        assert found.coefficients_at in ("cell", "vertex")

    @pytest.mark.parametrize("alpha", [1e-12, 1e-4, 0.3, 5.0, 1e4])
    def test_uniform_medium_is_exact(self, scheme, alpha):
        grid = vm.CartesianGrid(*EDGES)
        ones = np.ones(grid.shape)
        volume = vm.Volume(grid, j0=0.7 * ones, j1=0.2 * ones, a0=alpha * ones, a1=2 * alpha * ones)
        image = self.render(scheme, volume, background=[3.0, 0.5])
        tau = image.optical_depth
        expected = np.array([0.7, 0.1]) * -np.expm1(-tau) / alpha + np.exp(-tau) * [3.0, 0.5]
        np.testing.assert_allclose(image.intensity, expected, rtol=self.rounding)
        chord = tau[..., 0] / alpha
        np.testing.assert_allclose(tau[..., 1], 2 * alpha * chord, rtol=1e-14)

    def test_pure_emitter_shines(self, scheme):
        volume = random_volume()
        dark = vm.Coefficients(["j0", "j1"], "0*a0")
        image = self.render(scheme, volume, dark)
        # The optical depth of an extinction is an integral as the intensity of an emitter is.
        column = self.render(scheme, volume, vm.Coefficients(["j0", "j1"], ["j0", "j1"]))
        np.testing.assert_allclose(image.intensity, column.optical_depth, rtol=1e-13)
        np.testing.assert_array_equal(image.transparency, 1.0)

    def test_pure_absorber_dims_the_background(self, scheme):
        volume = random_volume()
        image = self.render(scheme, volume, vm.Coefficients(["0", "0"], ["a0", "a1"]))
        lit = self.render(
            scheme, volume, vm.Coefficients(["0", "0"], ["a0", "a1"]), background=[2.0, 3.0]
        )
        assert not image.intensity.any()
        np.testing.assert_allclose(lit.intensity, np.exp(-lit.optical_depth) * [2, 3], rtol=1e-13)

    @pytest.mark.parametrize("start", [False, True])
    def test_both_directions_give_the_same(self, scheme, start):
        volume, rays = random_volume(), lines(start=start)
        forth, back = (
            self.render(one, volume, camera=rays, background=1.0) for one in both_ways(scheme)
        )
        # The same segments, to the rounding of distances counted from the other end.
        for name in ("intensity", "transparency", "optical_depth"):
            np.testing.assert_allclose(getattr(forth, name), getattr(back, name), rtol=1e-12)

    def test_grey_is_one_extinction_for_all_channels(self, scheme):
        volume = random_volume()
        grey = self.render(scheme, volume, vm.Coefficients(["j0", "j1"], "a0"))
        each = self.render(scheme, volume, vm.Coefficients(["j0", "j1"], ["a0", "a0"]))
        np.testing.assert_allclose(grey.intensity, each.intensity, rtol=1e-14)

    def test_single_precision_is_close_to_double(self, scheme):
        volume = random_volume()
        double, single = (
            self.render(scheme, volume, precision=p).intensity for p in ("double", "single")
        )
        # A dozen segments, each with a few roundings of 6e-8.
        np.testing.assert_allclose(single, double, rtol=0, atol=1e-5 * double.max())

    @pytest.mark.parametrize("precision", ["single", "double"])
    @pytest.mark.parametrize("depth", [1e-30, 1e-8, 1.0, 1e6, 1e30])
    def test_no_depth_gives_nonsense(self, scheme, precision, depth):
        volume = random_volume(depth=depth)
        image = self.render(scheme, volume, precision=precision, background=1.0)
        assert np.isfinite(image.intensity).all()
        assert (image.intensity >= 0).all()
        assert (image.transparency >= 0).all()
        assert (image.transparency <= 1).all()

    def test_twice_the_emission_is_twice_as_bright(self, scheme):
        volume = random_volume()
        once = self.render(scheme, volume)
        twice = self.render(scheme, volume, vm.Coefficients(["2*j0", "2*j1"], ["a0", "a1"]))
        # A multiplication by two is exact.
        np.testing.assert_allclose(twice.intensity, 2 * once.intensity, rtol=1e-14)
