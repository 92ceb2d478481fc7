"""Pictures can be differentiated: the arrays of a backend record what is computed with them."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from voluminous.backend import dr, get_backend
from voluminous.backend.functions import split_log
from voluminous.rendering.pixels import whole_picture
from voluminous.rendering.prepare import prepare
from voluminous.rendering.run import make_tracer

AXIS = np.linspace(-1, 1, 5)
GRIDS = {
    "uniform": lambda: vm.CartesianGrid.uniform(8, (-1, 1)),
    "octree": lambda: vm.OctreeGrid.from_function(*[AXIS] * 3, lambda x, y, z, size: x > y, 2),
    "spherical": lambda: vm.SphericalGrid(
        np.linspace(0.1, 1, 9), np.linspace(0, np.pi, 7), np.linspace(0, 2 * np.pi, 9)
    ),
}
MEDIUM = vm.Gaussian("log10(a)", -0.3, 0.2, (1.0, 1.0), 0.7, 0.1)
CAMERA = vm.Orthographic(60, 30, width=2.5, resolution=16)


def light(volume, factor, precision, scheme):
    """Return the light of all pixels, of a volume whose coefficients are multiplied by a factor."""
    job, _ = prepare(volume, MEDIUM, CAMERA, scheme=scheme, cutoff=0.0)
    job.backend = get_backend("cpu", precision, derivatives=True)
    tracer = make_tracer(job, 0.0)
    tracer.source.packets = [packet * factor for packet in tracer.source.packets]
    lanes = whole_picture(job.frame.pixels, job.backend)
    path = tracer.march(tracer._ray(lanes)).path
    return dr.sum(sum(dr.select(lanes.there, n, 0.0) for n in path.emission))


@pytest.mark.parametrize("scheme", ["first-order", "second-order"])
@pytest.mark.parametrize("grid", GRIDS)
def test_the_light_of_a_picture_has_a_derivative(grid, scheme):
    grid = GRIDS[grid]()
    volume = vm.Volume(grid, a=np.random.default_rng(0).uniform(0.1, 1, grid.shape))
    # What a plain picture keeps with the volume must not reach kernels that are differentiated.
    plain = vm.render(volume, MEDIUM, CAMERA, scheme=scheme, precision="double", cutoff=0.0)
    Float = get_backend("cpu", "double", derivatives=True).Float
    factor = Float(1.0)
    dr.enable_grad(factor)
    total = light(volume, factor, "double", scheme)
    dr.forward(factor)
    step = 1e-5
    ends = [light(volume, Float(1.0 + s), "double", scheme)[0] for s in (-step, step)]
    np.testing.assert_allclose(dr.grad(total)[0], (ends[1] - ends[0]) / (2 * step), rtol=1e-6)
    unit = plain.intensity.sum() / total[0]
    np.testing.assert_allclose(np.log2(unit), np.round(np.log2(unit)), atol=1e-9)
    again = vm.render(volume, MEDIUM, CAMERA, scheme=scheme, precision="double", cutoff=0.0)
    np.testing.assert_array_equal(again.intensity, plain.intensity)


def test_logarithms_by_bits_have_derivatives():
    Float = get_backend("cpu", "single", derivatives=True).Float
    x = Float([1e-30, 0.3, 1.0, 7.0, 1e20])
    dr.enable_grad(x)
    n, rest = split_log(x)
    dr.forward(x)
    np.testing.assert_allclose(np.array(dr.grad(rest)) * np.array(x), 1.0, rtol=1e-6)
    np.testing.assert_allclose(n * np.log(2) + rest, np.log(np.array(x)), rtol=1e-6)
