"""Scheme ``olson-kunasz``: RADMC-3D's second order, its branches, and its rounding."""

from __future__ import annotations

import numpy as np
import pytest

import reference
import voluminous as vm
from contracts.bundle import on_a_sphere
from contracts.grid import make_ray, walk_along
from scenes import camera_of
from voluminous.backend import dr, get_backend

# Where RADMC-3D changes its formula: optical depth 1e-6, and 1e-9 in single precision.
SERIES_BELOW, THIN_BELOW = 1e-6, float(np.float32(1e-9))


def one_cell(emissivity, extinction, precision="double", **options):
    """Return the one pixel that looks through a homogeneous unit cube."""
    volume = vm.Volume(vm.CartesianGrid.uniform((1, 1, 1), (0, 1)), j=np.ones((1, 1, 1)))
    medium = vm.Coefficients([f"{emissivity!r}*j"], [f"{extinction!r}*j"])
    camera = vm.Orthographic(resolution=1, width=0.5)
    return vm.render(
        volume, medium, camera, scheme="olson-kunasz", precision=precision, device="cpu", **options
    )


def radmc(j, alpha):
    """Return emission and transparency of a unit length by RADMC-3D's formulas."""
    tau, source = alpha, j / (alpha + 1e-99)
    if tau <= THIN_BELOW:
        return j, 1 - tau
    if tau <= SERIES_BELOW:
        return min(0.5 * tau * source + 0.5 * tau * source, j), 1 - tau
    e = np.exp(-tau)
    front = (tau - (1 - e)) / tau
    return min(((1 - e) - front) * source + front * source, j), e


@pytest.mark.parametrize(
    "alpha",
    [0.0, 1e-12, 0.99 * THIN_BELOW, 1.01 * THIN_BELOW, 1e-7, 0.99e-6, 1.01e-6, 1e-3, 0.3, 40.0],
)
def test_every_branch_is_radmcs(alpha):
    image = one_cell(0.7, alpha)
    emission, transparency = radmc(0.7, alpha)
    # One segment: a few roundings; 1 - exp(-tau) loses digits, 1e-16 / tau of the emission.
    slack = 1e-15 + (3e-16 / alpha if alpha > SERIES_BELOW else 0)
    np.testing.assert_allclose(image.intensity.item(), emission, rtol=slack)
    np.testing.assert_allclose(image.transparency.item(), transparency, rtol=1e-15)
    np.testing.assert_allclose(image.optical_depth.item(), alpha, rtol=1e-15)


def test_emission_is_capped_by_the_thin_trapezoid():
    # From an opaque dark cell to a clear bright one S runs from 0 to 1e9: linear in tau it
    # would emit far more than is there.
    edges = ([0.0, 1.0], [0.0, 1.0], [0.0, 1.0, 2.0])
    j, a = np.array([[[0.0, 1.0]]]), np.array([[[1.0, 1e-9]]])
    volume = vm.Volume(vm.CartesianGrid(*edges), j=j, a=a)
    camera = vm.Orthographic(resolution=1, width=0.5)
    medium = vm.Coefficients(["j"], ["a"])
    image = vm.render(volume, medium, camera, scheme="olson-kunasz", precision="double")
    # Vertices along z hold (0, 1/2, 1): segments of 1/4 (attenuated in front) and 3/4.
    assert 0.5 < image.intensity.item() <= 0.75 + 0.25


@pytest.mark.parametrize("order", ["front-to-back", "back-to-front"])
@pytest.mark.parametrize("cutoff", [None, 0.5])
def test_neither_order_nor_cutoff_matter_in_double_precision(order, cutoff):
    expected = one_cell(1.0, 5.0)
    image = one_cell(1.0, 5.0, order=order, cutoff=cutoff)
    np.testing.assert_array_equal(image.intensity, expected.intensity)
    np.testing.assert_array_equal(image.optical_depth, expected.optical_depth)


def test_single_precision_is_near_double_precision():
    single, double = (one_cell(1.0, 0.4, p).intensity for p in ("single", "double"))
    # tau - (1 - exp(-tau)) in single precision: 6e-8 / tau, a few times.
    np.testing.assert_allclose(single, double, rtol=2e-6)


def second_order_cases(*models):
    """Return (model, case) of RADMC-3D's second-order intensities; skipped without the data."""
    if reason := reference.why_absent():
        return [pytest.param("", "", marks=pytest.mark.skip(reason=reason), id="no data")]
    found = []
    for name in models:
        for case in reference.load_model(name).cases.values():
            if case.order == 2 and case.quantity == "intensity" and not case.interpolates_source:
                found.append(pytest.param(name, case.id, id=f"{name}-{case.id}"))
    return found


@pytest.mark.parametrize(("name", "case_id"), second_order_cases("core", "random32", "nonuniform"))
def test_last_bits_are_radmcs(name, case_id):
    """RADMC-3D's noise is part of its images: j and α given, so that only rays are compared."""
    model = reference.load_model(name)
    case = model.cases[case_id]
    channels = range(model.nchan)
    columns = {f"j{c}": np.ascontiguousarray(model.j[..., c]) for c in channels}
    columns |= {f"a{c}": np.ascontiguousarray(model.alpha[..., c]) for c in channels}
    image = vm.render(
        vm.Volume(vm.CartesianGrid(*model.edges, unit="cm"), columns),
        vm.Coefficients([f"j{c}" for c in channels], [f"a{c}" for c in channels]),
        camera_of(case),
        scheme="olson-kunasz",
        precision="double",
        device="cpu",
        background=case.background,
        antialias="radmc3d" if case.camera["fluxcons"] else None,
    )
    error = np.abs(image.intensity - case.image).max() / np.abs(case.image).max()
    # One last bit of one path length that differed would be 1e-9 in `core`; 8e-11 is left of the
    # last bits of the coefficients.
    assert error < 2e-10


@pytest.fixture
def parallel_rays():
    """A grid of uneven cells, and rays from a camera at infinity with RADMC-3D's starts."""
    rng = np.random.default_rng(3)
    edges = [np.cumsum(rng.uniform(0.2, 1.0, n)) - 2 for n in (9, 7, 8)]
    grid, backend = vm.CartesianGrid(*edges), get_backend("cpu", "double")
    direction = on_a_sphere(1, seed=4)
    aims = rng.uniform(*grid.bounds.T, size=(64, 3))
    ray = make_ray(backend, aims, np.repeat(direction, len(aims), axis=0))
    ray.start = [o - 30.0 * d for o, d in zip(ray.origin, ray.direction, strict=True)]
    return grid, backend, ray


def test_reckoned_walk_visits_the_same_cells(parallel_rays):
    grid, backend, ray = parallel_rays
    plain = walk_along(grid, backend, ray)
    reckoned = walk_along(_Reckoned(grid), backend, ray)
    np.testing.assert_array_equal(reckoned.active, plain.active)
    np.testing.assert_array_equal(reckoned.cell[plain.active], plain.cell[plain.active])
    # Positions of size 30 are rounded: 4e-15, and again at each of some 20 walls.
    np.testing.assert_allclose(reckoned.length, plain.length, rtol=0, atol=1e-13)


def test_reckoned_walk_interpolates_where_the_ray_is(parallel_rays):
    grid, backend, ray = parallel_rays
    shape = [n + 1 for n in grid.shape]
    places = np.stack(np.meshgrid(*grid.edges, indexing="ij"), axis=-1).reshape(-1, 3)
    assert len(places) == np.prod(shape)

    def visit(walk, track, cursor, segment):
        active = np.asarray(segment.active)
        for corners, position in (
            (walk.entry_corners(track, cursor), cursor.position),
            (walk.exit_corners(track, segment), walk.next(track, cursor)[1].position),
        ):
            weighted = sum(
                np.asarray(w + dr.zeros(backend.Float, len(active)))[active, None]
                * places[np.asarray(v)[active]]
                for v, w in zip(corners.vertex, corners.weight, strict=True)
            )
            there = np.stack([np.asarray(p)[active] for p in position], axis=-1)
            np.testing.assert_allclose(weighted, there, rtol=0, atol=1e-13)

    walk_along(_Reckoned(grid), backend, ray, visit)


class _Reckoned:
    """A grid whose walk is the one by dead reckoning."""

    def __init__(self, grid):
        self.grid, self.scale = grid, grid.scale

    def walk(self, backend):
        return self.grid.walk(backend, "reckoned")
