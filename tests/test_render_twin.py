"""Random scenes against the plain NumPy twin, which shares no code with the package."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
import voluminous as vm
from contracts.scheme import both_ways

# The twin sorts all crossings of a ray: its rounding is another, of some 1e-15 per segment.
AGREEMENT = 1e-10
widths = st.lists(st.floats(0.05, 2.0), min_size=2, max_size=5)
numbers = st.integers(0, 2**32 - 1)


def edges_of(cells, start):
    """Return edges of cells of these widths; two of them never look equal."""
    return start + np.concatenate(
        [[0.0], np.cumsum(np.multiply(cells, 1 + 1e-3 * np.arange(len(cells))))]
    )


@st.composite
def scenes(draw):
    """Draw edges, coefficients (with zeros) of two channels, and a background."""
    edges = tuple(edges_of(draw(widths), start) for start in (-1.0, 0.3, -2.0))
    rng = np.random.default_rng(draw(numbers))
    shape = (*(len(e) - 1 for e in edges), 2)
    depth = draw(st.sampled_from([1e-6, 0.01, 1.0, 30.0]))
    coefficients = rng.uniform(size=(2, *shape)) * np.array([1.0, depth]).reshape(2, 1, 1, 1, 1)
    coefficients[rng.uniform(size=coefficients.shape) < draw(st.sampled_from([0.0, 0.5]))] = 0.0
    return edges, *coefficients, np.array(draw(st.sampled_from([(0.0, 0.0), (1.0, 0.3)])))


@st.composite
def views(draw, *, inside=None):
    """Draw a camera of the twin; angles that no wall has, or what is on a wall is left to luck."""
    off = 0.1234567 * np.sqrt(2)
    incl, phi, posang = (draw(st.integers(0, 360)) + off for _ in range(3))
    pixels, size = draw(st.sampled_from([(5, 4), (3, 7)])), draw(st.floats(0.5, 4.0))
    if inside is None:
        point = (0.1, 1.0, 0.2)
        return twin.Camera(*pixels, (size, size / 2), point, incl, phi, posang)
    eye = (-0.91, 0.37, -1.93) if inside else (5.1, -4.2, 3.3)
    target = (0.1 + draw(st.floats(-1, 1)), 1.0, 0.2)
    projection = draw(st.sampled_from([1, 2]))
    return twin.Camera(
        *pixels, (size / 3, size / 4), target, 0, 0, posang, (0, 0), eye, projection, 10 * size
    )


def camera_of(view):
    """Return the camera that the twin's is."""
    width, pixels = [2 * h for h in view.half_size], (view.nx, view.ny)
    if view.observer is None:
        angles = (view.incl, view.phi, view.posang)
        return vm.Orthographic(*angles, width=width, resolution=pixels, center=view.point)
    return vm.Perspective(
        view.observer,
        view.point,
        width=width,
        posang=view.posang,
        resolution=pixels,
        projection={1: "flat", 2: "spherical"}[view.projection],
        zenith=view.zenith,
    )


def compare(scene, view, scheme, solver=None, **options):
    """Assert that both make the same picture, transparency and optical depth."""
    edges, j, alpha, background = scene
    fields = {f"j{c}": j[..., c] for c in (0, 1)} | {f"a{c}": alpha[..., c] for c in (0, 1)}
    image = vm.render(
        vm.Volume(vm.CartesianGrid(*edges), fields),
        vm.Coefficients(["j0", "j1"], ["a0", "a1"]),
        camera_of(view),
        scheme=solver or scheme,
        precision="double",
        background=background,
        cutoff=0,
        **options,
    )
    samples = "flux-conserving" if "antialias" in options else options.get("samples", 1)
    expected = twin.render(edges, j, alpha, view, scheme, background=background, samples=samples)
    for name, plane in expected.items():
        scale = max(np.abs(plane).max(), 1e-12)
        np.testing.assert_allclose(getattr(image, name), plane, rtol=0, atol=AGREEMENT * scale)


# Olson-Kunasz is compared where it is well defined: it divides j by the extinction, and near
# τ = 1e-6 the result depends on the last bits of path lengths (see test_radmc3d).
SCHEMES = ["first-order", "second-order"]


@settings(max_examples=30)
@pytest.mark.parametrize("scheme", SCHEMES)
@given(scene=scenes(), view=views())
def test_parallel_rays(scheme, scene, view):
    compare(scene, view, scheme)


@settings(max_examples=15)
@pytest.mark.parametrize("scheme", SCHEMES)
@given(scene=scenes(), view=views(inside=True))
def test_observer_inside(scheme, scene, view):
    compare(scene, view, scheme)


@settings(max_examples=15)
@pytest.mark.parametrize("scheme", SCHEMES)
@given(scene=scenes(), view=views(inside=False), backward=st.booleans())
def test_observer_outside(scheme, scene, view, backward):
    compare(scene, view, scheme, both_ways(scheme)[backward])


@settings(max_examples=10)
@pytest.mark.parametrize("scheme", SCHEMES)
@given(scene=scenes(), view=views(), samples=st.sampled_from([2, 3, "radmc3d"]))
def test_samples(scheme, scene, view, samples):
    rays = {"samples": samples} if isinstance(samples, int) else {"antialias": samples}
    compare(scene, view, scheme, **rays)


@settings(max_examples=20)
@given(scene=scenes(), view=views())
def test_olson_kunasz(scene, view):
    edges, j, alpha, background = scene
    compare((edges, j, 0.3 + alpha, background), view, "olson-kunasz")


@settings(max_examples=10)
@pytest.mark.parametrize("scheme", SCHEMES)
@given(seed=numbers, view=views())
def test_equal_cells(scheme, seed, view):
    edges = (np.linspace(-1, 2, 6), np.linspace(0, 2, 4), np.linspace(-2, 1, 5))
    j, alpha = np.random.default_rng(seed).uniform(size=(2, 5, 3, 4, 2))
    compare((edges, j, alpha, np.zeros(2)), view, scheme)
