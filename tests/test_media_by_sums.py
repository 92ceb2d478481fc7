"""Media of expressions beside plain sums of NumPy's along the same rays, with noise and a vacuum.

The expressions were found by drawing some hundred at random: in each of them something was missed.
"""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from test_guaranteed_bounds import rays, trilinear
from voluminous.expressions import Expression, NumpyOps

pytestmark = pytest.mark.exhaustive

CELLS, PIXELS, STEPS = 10, 14, 6000
GRID = vm.CartesianGrid.uniform(CELLS, (-1, 1))
CAMERA = vm.Orthographic(40, 30, width=2.2, resolution=PIXELS)
# What the sums are off by at jumps: a step or two of each ray, over the brightest.
SUMS = 1e-3


def volume():
    """Return noise that ends in a vacuum, and a field that changes its sign in one half."""
    rng = np.random.default_rng(1)
    x, y, z = np.meshgrid(*[np.linspace(-1, 1, CELLS)] * 3, indexing="ij")
    r = np.sqrt(x * x + y * y + z * z)
    n = np.where(r < 0.8, np.exp(-2 * r) * (1 + rng.random(r.shape)), 0.0)
    t = np.where(r < 0.9, 10 ** rng.uniform(0, 1, r.shape), 0.0)
    return vm.Volume(GRID, n=n, t=t, w=np.where(x < 0, rng.normal(size=r.shape), 1.0))


def by_sums(scene, emissivity, extinction):
    """Return what is seen of j and α in small steps, each of them as if it were alone."""
    origin, direction = (part[:, None] for part in rays(CAMERA, GRID))
    sides = (GRID.bounds.T - origin) / direction
    first, last = sides.min(axis=1).max(axis=1), sides.max(axis=1).min(axis=1)
    step = np.maximum(last - first, 0.0)[:, None] / STEPS
    s = first[:, None] + step * (np.arange(STEPS) + 0.5)
    place = list(np.moveaxis(origin + s[..., None] * direction, -1, 0))
    fields = {name: trilinear(scene.array(name), GRID.edges, place) for name in scene.fields}
    fields |= dict(zip("xyz", place, strict=True), r=np.sqrt(sum(p * p for p in place)))
    j, alpha = (
        np.broadcast_to(Expression(text).evaluate(NumpyOps(), fields), s.shape)
        for text in (emissivity, extinction)
    )
    depth = alpha * step
    before = np.cumsum(depth, axis=1) - depth
    return (j * step * np.exp(-0.5 * depth - before)).sum(axis=1)


def shell(x, center, sigma):
    return f"exp(-0.5*((({x}) - {center})/{sigma})**2)"


RATIOS = ["(x + n)/tanh(t)", "10**(sin(n))/t", "1/max(n, t)", "log10(t/(n + 0.01))"]
GATES = ["max(3*n, n)/(sqrt(w) + r**n) > 0.5", "1/n < 3", "n/t > 0.1", "sqrt(w) > 0.7 or n > 0.5"]
COEFFICIENTS = [
    "1 + tanh(20*(n - 0.5))",
    "where(n > 0, n*abs(log10(n)), 0)",
    "exp(-0.1/n)",
    "10**(0.3*log10(n))",
    "n**2*interp(t, [1, 3, 5, 8], [0, 2, 1, 4])",
    "t % 3",
]


def check(medium, emissivity, extinction, precision, sums=SUMS):
    scene = volume()
    image = vm.render(scene, medium, CAMERA, precision=precision)
    exact = by_sums(scene, emissivity, extinction).reshape(PIXELS, PIXELS)
    off, brightest = np.abs(image.intensity[..., 0] - exact), exact.max()
    assert np.mean(off > image.error + sums * brightest) <= 0.01  # 99 % as promised
    assert off.max() < (2e-3 + sums) * brightest  # twice the tolerance


# Expressions that are no cubics, some of them as steep as can be, in tables with few entries.
CURVED = {
    "log10(n)": [-2, 0.5],
    "log10(t)": [-1, 0, 1],
    "sqrt(t)": [0, 3],
    "10**n": [1, 4, 8],
    "t**2": [0, 30, 60],
    "1/t": [0, 1],
}


def cases():
    """Yield media, emissivities, extinctions, and the error of sums."""
    for text, nodes in CURVED.items():
        colors = [0.0, 1.0, 0.2][: len(nodes)]
        medium = vm.Table(text, nodes, colors, [0.3 * c for c in colors], 1.0)
        # There are no jumps: sums of 6000 parts are off by a square of one of them.
        yield medium, f"interp({text}, {nodes}, {colors})", None, 1e-5
    for text in RATIOS:
        yield vm.Gaussian(text, 1.0, 0.2, 1, 0.3, 1.0), shell(text, 1.0, 0.2), None, SUMS
    for text in GATES:
        medium = vm.Gaussian("r", 0.7, 0.3, 1, 0.3, 1.0, where=text)
        yield medium, f"where({text}, {shell('r', 0.7, 0.3)}, 0)", None, SUMS
    for text in COEFFICIENTS:
        yield vm.Coefficients(text, "0.3*n"), text, "0.3*n", SUMS


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("case", cases(), ids=lambda case: case[1])
def test_pictures_are_those_of_sums(case, precision):
    medium, emissivity, extinction, sums = case
    check(medium, emissivity, extinction or f"0.3*({emissivity})", precision, sums)
