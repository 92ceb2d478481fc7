"""Results of measurements do not change: what they hold is converted, not relabelled."""

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from voluminous.errors import ImmutableError


def results():
    grid = vm.CartesianGrid.uniform(4, (-1, 1), unit="pc")
    values = np.random.default_rng(1).uniform(1.0, 2.0, grid.shape)
    volume = vm.Volume(grid, density=values * u.g / u.cm**3, speed=values * u.km / u.s)
    camera = vm.Orthographic(resolution=4)
    medium = vm.Gaussian("density", 1.5, 0.5, 1.0, 1.0, 1.0)
    yield vm.moments(volume, "density", camera, "speed"), "mean"
    yield vm.measure(volume, "density"), "volume"
    yield vm.tau_surface(volume, medium, camera, 0.1), "depth"
    yield vm.probe(volume, medium, camera, (2, 2)), "units"
    yield volume.slice("density", (0, 0, 1)), "unit"


def test_assigning_to_a_result_is_refused():
    for result, name in results():
        for each in (name, "anything"):
            with pytest.raises(ImmutableError, match=f"{type(result).__name__}.{each} cannot be"):
                setattr(result, each, "pc")


def test_maps_of_results_are_converted():
    moments, totals, surface, *_ = (result for result, _ in results())
    np.testing.assert_allclose(
        moments.mean.to("m/s").intensity, 1000 * moments.mean.intensity, rtol=1e-6
    )
    assert totals["density"].to("Msun").unit == u.Msun
    depth = surface.depth.to("cm")
    assert (depth.unit, depth.intensity_unit) == ("cm", "cm")
    factor = u.pc.to(u.cm)
    np.testing.assert_allclose(depth.intensity, factor * surface.depth.intensity, rtol=1e-12)
