"""The twin against closed forms and against images of the real RADMC-3D."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import reference
import twin

# 100^3 cells are slow in NumPy: of the core model's images every 3rd row and column is compared
# (from row 0, column 0). The other models are compared in full.
STRIDE = {"core": 3}

EDGES = (
    np.array([-1.0, -0.3, 0.1, 0.8, 2.0]),
    np.array([0.0, 0.5, 0.75, 3.0]),
    np.array([-2.0, -1.0, 1.0]),
)
LOOK = twin.Camera(
    9, 7, (3.6, 2.8), point=(0.5, 1.2, 0.1), incl=57.0, phi=213.0, posang=31.0
)  # sees EDGES from an angle at which no ray meets an edge of a cell


def compare(model_name, case_id, scheme, **options):
    """Return the largest difference from the reference image over that image's maximum."""
    model = reference.load_model(model_name)
    case = model.cases[case_id]
    camera = twin.Camera.from_case(case)
    stride = STRIDE.get(model_name, 1)
    pixels = tuple(np.ogrid[: camera.ny : stride, : camera.nx : stride])
    image = twin.render(
        model.edges,
        # RADMC-3D carries S = j / alpha, and S alpha ds is 0 where alpha is exactly 0
        np.where(model.alpha == 0, 0.0, model.j),
        model.alpha,
        camera,
        scheme,
        background=case.background,
        samples="flux-conserving" if case.camera["fluxcons"] else 1,
        interpolate_source=case.interpolates_source,
        pixels=pixels,
        **options,
    )
    quantity = {"intensity": "intensity", "tau": "optical_depth"}[case.quantity]
    return np.abs(image[quantity] - case.image[pixels]).max() / np.abs(case.image).max()


def cases_of_order(order):
    """Return the reference cases of that order; surfaces of given optical depth are left out."""
    chosen = []
    for parameter in reference.cartesian_cases():
        name, case_id = parameter.values
        case = reference.load_model(name).cases[case_id] if name else None
        if case is None or (case.order == order and case.quantity != "tausurf"):
            chosen.append(parameter)
    return chosen


@pytest.mark.parametrize(("model", "case"), cases_of_order(1))
def test_first_order_with_radmc_branch_is_radmc(model, case):
    # Same formulas; only path lengths are rounded differently: 1e-14 each at 1e-2 of the box.
    assert compare(model, case, "first-order", radmc_branch=True) < 1e-12


@pytest.mark.each_value_once
@pytest.mark.parametrize(("model", "case"), cases_of_order(2))
def test_olson_kunasz_is_radmc(model, case):
    # tau - (1 - exp(-tau)) near tau = 1e-6 is known to 1e-16 / tau^2 only: a last bit of exp
    # or of a path length that differs shows as up to 1e-9 of the maximum. With the same rounding
    # of positions what remains is one such flip in many images.
    assert compare(model, case, "olson-kunasz", radmc_rounding=True) < 1e-10


@pytest.mark.parametrize("scheme", twin.SCHEMES)
@pytest.mark.parametrize("alpha", [1e-30, 1e-3, 0.4, 30.0])
def test_uniform_slab(scheme, alpha):
    j, background = np.array([0.7, 0.2]), np.array([3.0, 0.0])
    shape = (4, 3, 2, 2)
    image = twin.render(
        EDGES, j * np.ones(shape), np.full(shape, alpha), LOOK, scheme, background=background
    )
    tau = alpha * chords(EDGES, LOOK)[..., None]
    emitted = np.where(tau > 1e-8, -np.expm1(-tau), tau) / alpha * j
    # Olson-Kunasz subtracts nearly equal numbers at small tau: 1e-16 / tau^2 of a segment's part
    tolerance = 1e-9 if scheme == "olson-kunasz" else 1e-14
    np.testing.assert_allclose(image["optical_depth"], np.broadcast_to(tau, (7, 9, 2)), 1e-13)
    expected = emitted + np.exp(-tau) * background
    np.testing.assert_allclose(image["intensity"], expected, tolerance, 1e-14)
    np.testing.assert_allclose(image["transparency"], np.exp(0 * j - tau), 1e-12, 1e-14)


def chords(edges, camera):
    """Lengths (ny, nx) of rays in the box, by the slab method written out for one ray."""
    length = np.zeros((camera.ny, camera.nx))
    for iy, ix in np.ndindex(length.shape):
        px, py = camera.pixel_centres(np.array([iy]), np.array([ix]))
        rays = camera.rays(px, py)
        near, far = -np.inf, rays.t_end
        for axis, walls in enumerate(edges):
            limits = (walls[[0, -1]] - rays.origins[0, axis]) / rays.directions[0, axis]
            near, far = max(near, limits.min()), min(far, limits.max())
        length[iy, ix] = max(far - near, 0.0)
    return length


directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: np.linalg.norm(d) > 1e-3)
points = st.tuples(st.floats(-1, 2), st.floats(0, 3), st.floats(-2, 1))


@settings(max_examples=200, deadline=None)
@given(points, directions, st.sampled_from([0.0, np.inf]))
def test_pieces_join_up_and_lie_in_their_cells(origin, direction, t_end):
    o = np.array([origin])
    d = np.array([direction]) / np.linalg.norm(direction)
    pieces = twin.segments(EDGES, o, d, t_end)
    assert (pieces.length > 0).all()
    np.testing.assert_array_equal(pieces.t0[1:], pieces.t1[:-1])
    np.testing.assert_array_equal(pieces.step, np.arange(len(pieces.step)))
    for axis, walls in enumerate(EDGES):
        low, high = walls[pieces.cell[axis]], walls[pieces.cell[axis] + 1]
        middle = 0.5 * (pieces.start + pieces.end)[:, axis]
        # positions are of order 1: rounding of t * d
        assert (low - 1e-13 <= middle).all()
        assert (middle <= high + 1e-13).all()


def test_vertices_average_the_cells_that_exist():
    cells = np.arange(24.0).reshape(4, 3, 2, 1)
    vertices = twin.vertex_means(cells)
    assert vertices[0, 0, 0] == cells[0, 0, 0]
    assert vertices[1, 0, 0] == cells[:2, 0, 0].mean()
    assert vertices[2, 1, 1] == cells[1:3, :2, :].mean()
    assert vertices[4, 3, 2] == cells[3, 2, 1]


def test_interpolation_reproduces_a_trilinear_function():
    rng = np.random.default_rng(1)
    x = rng.uniform([-1, 0, -2], [2, 3, 1], (50, 3))
    cell = tuple(np.searchsorted(e, x[:, a]) - 1 for a, e in enumerate(EDGES))

    def value(p):
        return (1 + p[..., 0]) * (2 - p[..., 1]) * (3 + 2 * p[..., 2])

    corners = np.stack(np.meshgrid(*EDGES, indexing="ij"), axis=-1)
    found = twin.interpolate(EDGES, value(corners)[..., None], cell, x)
    np.testing.assert_allclose(found[:, 0], value(x), rtol=1e-13, atol=1e-13)


def test_second_order_against_arbitrary_precision():
    mpmath = pytest.importorskip("mpmath")
    rng = np.random.default_rng(2)
    for _ in range(40):
        tau, ds = 10 ** rng.uniform(-12, 4), 10 ** rng.uniform(-3, 17)
        j0, j1, a0, a1 = rng.uniform(size=4) * rng.choice([0.0, 1e-6, 1.0], 4, p=[0.2, 0.1, 0.7])
        if a0 + a1 == 0 or j0 + j1 == 0:
            continue
        scale = tau / (0.5 * (a0 + a1) * ds)
        coefficients = j0, j1, a0 * scale, a1 * scale, ds
        b, theta, depth = twin.solve_second_order(*coefficients)
        expected = integrate(mpmath, *coefficients)
        # rounding of exp(-tau(u)), seen for u up to tau = 40, and of the weights
        assert abs(float(b) / expected - 1) < 1e-14
        assert abs(float(depth) / tau - 1) < 1e-14
        assert float(theta) == pytest.approx(np.exp(-tau), rel=1e-10)


def integrate(mpmath, j0, j1, a0, a1, ds):
    """The integral of j exp(-tau) with 30 digits, in panels that grow with optical depth."""
    with mpmath.workdps(30):
        j0, j1, a0, a1, ds = (mpmath.mpf(float(v)) for v in (j0, j1, a0, a1, ds))
        depth = (a0 + a1) * ds / 2

        def emission(u):
            return (j1 + (j0 - j1) * u / ds) * mpmath.exp(-u * (a1 + (a0 - a1) * u / (2 * ds)))

        ends, reached = [mpmath.mpf(0)], mpmath.mpf(1)
        while reached < min(depth, 120):
            ends.append(2 * reached / (a1 + mpmath.sqrt(a1**2 + 2 * (a0 - a1) * reached / ds)))
            reached *= 1.6
        return float(mpmath.quad(emission, ends if depth > 120 else [*ends, ds]))


def test_samples_are_means_of_quarter_pixels():
    rng = np.random.default_rng(4)
    j, alpha = rng.uniform(size=(2, 4, 3, 2, 1))
    once = twin.render(EDGES, j, alpha, LOOK, "first-order", samples=4)["intensity"]
    np.testing.assert_allclose(once, quartered(j, alpha, LOOK, levels=2), rtol=1e-13)


def quartered(j, alpha, camera, levels):
    """Every pixel as the mean of 4 quarter pixels, recursively: an image of (ny, nx, C)."""
    if levels == 0:
        return twin.render(EDGES, j, alpha, camera, "first-order")["intensity"]
    finer = twin.Camera(**{**vars(camera), "nx": 2 * camera.nx, "ny": 2 * camera.ny})
    quarters = quartered(j, alpha, finer, levels - 1)
    return quarters.reshape(camera.ny, 2, camera.nx, 2, -1).mean(axis=(1, 3))


def test_flux_conserving_recursion_ends_when_pixels_are_no_wider_than_the_first_cell():
    cell = EDGES[0][1] - EDGES[0][0]
    for pixels_per_cell, n in [(0.9, 2), (1.0, 1), (1.5, 1), (0.5, 2), (0.3, 4), (0.2, 8)]:
        half = 0.5 * cell / pixels_per_cell
        camera = twin.Camera(1, 2, (0.5 * half, 2 * half))
        assert twin.flux_conserving_samples(EDGES, camera) == n
