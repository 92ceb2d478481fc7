"""What rays find on their way: moments, extremes and their depth, surfaces of optical depth."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from contracts import box_limits
from voluminous.measuring.columns import lines_of_sight

RNG = np.random.default_rng(0)
GRID = vm.CartesianGrid.uniform(8, (-1, 1), unit="pc")
DOWN = vm.Orthographic(width=2, resolution=8)
FIELDS = {
    "a": RNG.normal(size=GRID.shape),
    "rho": (RNG.random(GRID.shape) + 0.1) * u.g / u.cm**3,
    "v_x": RNG.normal(size=GRID.shape) * u.km / u.s,
    "v_y": RNG.normal(size=GRID.shape) * u.km / u.s,
    "v_z": (RNG.normal(size=GRID.shape) + 1000) * u.km / u.s,
}
VOLUME = vm.Volume(GRID, FIELDS)
EXACT = {"single": 2e-6, "double": 1e-12}


@pytest.mark.parametrize("precision", EXACT)
@pytest.mark.parametrize(("kind", "best"), [("max", np.argmax), ("min", np.argmin)])
def test_extremes_of_columns_of_cells(kind, best, precision):
    found = vm.project(VOLUME, "a", DOWN, kind, depth=True, precision=precision)
    a, k = VOLUME.array("a"), best(VOLUME.array("a"), axis=2)
    expected = np.take_along_axis(a, k[..., None], 2)[..., 0].T
    np.testing.assert_allclose(found[0].intensity[..., 0], expected, rtol=EXACT[precision])
    # Away from the observer, who is above: depths run downwards.
    depth = 1 - (k.T + 0.5) / 4
    np.testing.assert_allclose(found[1].intensity[..., 0], depth, atol=EXACT[precision])
    assert found[1].intensity_unit == "pc"


# Layers of cells are 0.25 pc deep; the observer is above.
SLABS = {
    "of cells": ((-0.5, 0.5), slice(5, 7), [1, 1]),
    "of parts of cells": (("-0.55 pc", 0.5), slice(5, 8), [0.8, 1, 0.2]),
    "in a cell": ((0.1 * u.pc, 0.02), slice(3, 4), [0.08]),
}


@pytest.mark.parametrize("name", SLABS)
@pytest.mark.parametrize("how", ["max", "min", "mean", "integral"])
def test_a_slab_is_a_layer_across_the_view(name, how):
    slab, cells, parts = SLABS[name]
    a = VOLUME.array("a")[:, :, cells]
    found = vm.project(VOLUME, "a", DOWN, how, slab=slab, precision="double")
    total = (a * parts).sum(axis=2)
    expected = {
        "max": a.max(axis=2),
        "min": a.min(axis=2),
        "mean": total / np.sum(parts),
        "integral": 0.25 * total,
    }
    np.testing.assert_allclose(found.intensity[..., 0], expected[how].T, rtol=1e-12, atol=1e-14)


def test_a_slab_counts_from_the_observer_and_finds_places_inside_it():
    eye = vm.Perspective(position=(0, 0, 1e4), target=(0, 0, 0), width=2e-4, resolution=8)
    found, depth = vm.project(
        VOLUME, "a", eye, slab=(1e4 - 0.5, 0.4), depth=True, precision="double"
    )
    a = VOLUME.array("a")[:, :, 5:7]
    np.testing.assert_allclose(found.intensity[..., 0], a.max(axis=2).T, rtol=1e-12)
    wanted = 1e4 - np.where(np.argmax(a, axis=2) == 1, 0.6, 0.4).T  # chords are cut
    np.testing.assert_allclose(depth.intensity[..., 0], wanted, atol=1e-4)
    beyond = vm.project(VOLUME, "a", DOWN, slab=(3, 0.5))
    assert np.isnan(beyond.intensity).all()


@pytest.mark.parametrize(
    ("slab", "message"),
    [
        (3, "distance and a thickness"),
        ((0, 0), "thickness > 0"),
        ((0, "1 g"), "pc"),
        ((0, 1e-9), "far less than the volume"),
    ],
)
def test_what_is_no_slab_is_refused(slab, message):
    with pytest.raises(vm.VoluminousError, match=message):
        vm.project(VOLUME, "a", DOWN, slab=slab)
    with pytest.raises(vm.VoluminousError, match="rays"):
        vm.measuring.column(VOLUME, "a", DOWN, slab=(0, 1), method="exact")


def test_the_smallest_value_may_be_nothing():
    values = np.ones((64, 8, 8))
    values[:32] = 0.0  # blocks that pictures leap over
    volume = vm.Volume(vm.CartesianGrid.uniform((64, 8, 8), (0, 1)), a=values)
    camera = vm.Orthographic(90, 90, width=(1, 1), resolution=8)
    found = vm.project(volume, "a", camera, "min")
    np.testing.assert_array_equal(found.intensity, 0.0)


def test_the_first_cell_of_a_kind():
    found = vm.project(VOLUME, "a > 1.5", DOWN, "first", precision="double").intensity[..., 0]
    for (j, i), depth in np.ndenumerate(found):
        cells = np.flatnonzero(VOLUME.array("a")[i, j] > 1.5)
        assert np.isnan(depth) if not cells.size else depth == 1 - (cells[-1] + 1) / 4


def test_integral_and_mean_of_columns_of_cells():
    a = VOLUME.array("a")
    mean = vm.project(VOLUME, "a", DOWN, how="mean", precision="double").intensity[..., 0]
    np.testing.assert_allclose(mean, a.mean(axis=2).T, rtol=1e-12, atol=1e-12)
    integral = vm.project(VOLUME, "rho", DOWN, how="integral")
    np.testing.assert_array_equal(integral.intensity, vm.column(VOLUME, "rho", DOWN).intensity)
    assert integral.intensity_unit == "g / cm2"
    holes = vm.Volume(GRID, a=np.where(a > 1, np.nan, a))
    found = vm.project(holes, "a", DOWN, how="mean", precision="double").intensity[..., 0]
    np.testing.assert_allclose(found, np.nanmean(holes.array("a"), axis=2).T, atol=1e-12)
    with np.errstate(invalid="ignore"):
        expected = np.nanmean(np.log10(a), axis=2).T
    found = vm.project(VOLUME, "log10(a)", DOWN, how="mean", precision="double")
    np.testing.assert_allclose(found.intensity[..., 0], expected, atol=1e-12)


@pytest.mark.parametrize("precision", EXACT)
@pytest.mark.parametrize("method", ["rays", "exact"])
def test_moments_of_columns_of_cells(method, precision):
    found = vm.moments(VOLUME, "rho", DOWN, "v", 4, method=method, precision=precision)
    w, v = VOLUME.array("rho"), -VOLUME.array("v_z")
    total = w.sum(axis=2)
    mean = (w * v).sum(axis=2) / total
    off = v - mean[..., None]
    # The mean is subtracted before squares are taken: a speed of 1000 costs no digits.
    exact = 1e-4 if precision == "single" else 1e-10
    np.testing.assert_allclose(found.mean.intensity[..., 0], mean.T, rtol=1e-6)
    spread = np.sqrt((w * off**2).sum(axis=2) / total).T
    np.testing.assert_allclose(found.dispersion.intensity[..., 0], spread, rtol=exact)
    for k, image in enumerate(found.central, 2):
        expected = ((w * off**k).sum(axis=2) / total).T
        np.testing.assert_allclose(image.intensity[..., 0], expected, atol=10 * exact)
        assert u.Unit(image.intensity_unit) == (u.km / u.s) ** k
    assert u.Unit(found.column.intensity_unit) == u.g / u.cm**2
    assert found.mean.intensity_unit == "km / s"
    assert len(list(found)) == 3
    assert [len(list(vm.moments(VOLUME, "rho", DOWN, "v", n))) for n in (0, 1)] == [1, 2]


def test_weights_of_both_signs_may_add_up_to_next_to_nothing():
    charge = np.random.default_rng(4).normal(size=GRID.shape)
    velocity = np.random.default_rng(5).normal(size=GRID.shape) + 5.0
    volume = vm.Volume(GRID, charge=charge - charge.mean(), v=velocity)
    charge = volume.array("charge")
    found = vm.moments(volume, "charge", DOWN, "v").mean.intensity[..., 0]
    expected = ((charge * velocity).sum(axis=2) / charge.sum(axis=2)).T
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("scheme", ["first-order", "second-order", "post-classified"])
@pytest.mark.parametrize("precision", EXACT)
def test_an_even_medium_is_seen_into_as_deep_as_its_extinction_says(scheme, precision):
    volume = vm.Volume(GRID, k=np.full(GRID.shape, 2.0))
    for camera in (
        vm.Orthographic(50, 30, resolution=16),
        vm.Perspective((5, 4, 3), (0, 0, 0), fov=30, resolution=16),
    ):
        found = vm.tau_surface(
            volume, vm.Coefficients(0, "k"), camera, 1.5, scheme=scheme, precision=precision
        )
        origin, direction = (a.reshape(-1, 3) for a in lines_of_sight(camera, GRID))
        enter, leave = (t.reshape(16, 16) for t in box_limits(GRID.bounds, origin, direction))
        reached = leave - enter > 0.75
        depth = found.depth.intensity[..., 0]
        np.testing.assert_array_equal(np.isfinite(depth), reached)
        exact = 1e-5 if precision == "single" else 1e-11
        np.testing.assert_allclose(depth[reached], enter[reached] + 0.75, atol=exact)
        ends = origin.reshape(16, 16, 3) + (enter + 0.75)[..., None] * direction.reshape(16, 16, 3)
        np.testing.assert_allclose(found.points[reached, 0], ends[reached], atol=10 * exact)


def test_each_extinction_has_its_surface():
    volume = vm.Volume(GRID, k=np.full(GRID.shape, 2.0))
    found = vm.tau_surface(volume, vm.Coefficients([0, 0], ["k", "2 * k"]), DOWN, 1.0)
    np.testing.assert_allclose(found.depth.intensity[..., 0], 0.5 - 1)
    np.testing.assert_allclose(found.depth.intensity[..., 1], 0.25 - 1)


def test_missing_cells_are_not_found():
    values = np.ones((8, 8, 8))
    values[:, :, 7] = np.nan
    values[0, 0, 3] = 5.0
    volume = vm.Volume(GRID, a=values)
    found = vm.project(volume, "a", DOWN)
    assert found.intensity[0, 0, 0] == 5.0
    assert vm.project(volume, "a", DOWN, "min", depth=True)[1].intensity[4, 4, 0] == -0.625
    surface = vm.tau_surface(volume, vm.Coefficients(0, "a"), DOWN, 0.125)
    assert surface.depth.intensity[4, 4, 0] == pytest.approx(-1 + 0.25 + 0.125)


@pytest.mark.parametrize(
    "scheme", ["first-order", "second-order", "olson-kunasz", "post-classified"]
)
def test_surfaces_behind_missing_cells_are_where_the_depth_of_the_picture_is(scheme):
    """What a scheme carries from cell to cell goes on through one that holds nothing."""
    rng = np.random.default_rng(1)
    values = rng.random(GRID.shape) + 0.1
    values[rng.random(GRID.shape) < 0.4] = np.nan
    volume, medium = vm.Volume(GRID, a=values), vm.Coefficients(0, "a")
    camera = vm.Orthographic(37, 61, 20, width=1.6, resolution=8, center=(0, 0, 0))
    ray = vm.probe(
        volume, medium, camera, (3, 4), scheme=scheme, precision="double", tolerance=None
    )
    for tau in np.linspace(0.1, 0.95, 5) * ray.depth[-1, 0]:
        k = np.searchsorted(ray.depth[:, 0], tau)
        part = 1 - (ray.depth[k, 0] - tau) / ray.tau[k, 0]
        expected = ray.begin[k] + part * (ray.end[k] - ray.begin[k])
        found = vm.tau_surface(volume, medium, camera, tau, scheme=scheme).depth
        assert found.intensity[4, 3, 0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("method", ["rays", "exact"])
@pytest.mark.parametrize("weight", [None, "2 + a"])
def test_expressions_without_a_value_count_nothing(method, weight):
    """As fields that lack it there: log10(a) where a is negative."""
    volume = vm.Volume(GRID, a=VOLUME.array("a"))
    volume["logarithm"] = "log10(a)"
    assert np.isnan(volume.array("logarithm")).mean() > 0.4
    how = {"weight": weight, "method": method, "precision": "double"}
    maps = [vm.column(volume, q, DOWN, **how).intensity for q in ("log10(a)", "logarithm")]
    np.testing.assert_allclose(*maps, atol=1e-12)


def test_expressions_without_a_value_are_not_found():
    a = VOLUME.array("a")
    with np.errstate(invalid="ignore"):
        expected = np.nanmin(np.log10(a), axis=2).T
    found = vm.project(VOLUME, "log10(a)", DOWN, "min", precision="double")
    np.testing.assert_allclose(found.intensity[..., 0], expected, rtol=1e-12)
    found = vm.project(VOLUME, "log10(a)", DOWN, "first", precision="double").intensity[..., 0]
    first = np.argmax(a[..., ::-1] > 0, axis=2).T
    np.testing.assert_array_equal(found, first / 4 - 1)


@pytest.mark.parametrize("method", ["rays", "exact"])
def test_infinite_quantities_are_refused_by_name(method):
    """Else pixels that do not see the cell would be infinite too, or no numbers."""
    volume = vm.Volume(GRID, a=np.where(np.arange(8) == 3, 0.0, VOLUME.array("a")))
    with pytest.raises(vm.InputError, match=r"'1/a' is infinite .* \(0, 0, 3\)"):
        vm.column(volume, "1/a", DOWN, method=method)
    flow = vm.moments(volume, "abs(a)", DOWN, "1/a", 1, method=method)  # there is nothing there
    assert np.isfinite(flow.mean.intensity).all()


@pytest.mark.parametrize("scheme", ["first-order", "second-order", "post-classified"])
@pytest.mark.parametrize("extinction", ["a", "log10(a)"])
def test_surfaces_in_what_is_no_extinction_are_refused(scheme, extinction):
    """It is negative, or no number, in places: NaN would mean that surfaces are not reached."""
    with pytest.raises(vm.InputError, match=r"not finite|cannot be used in"):
        vm.tau_surface(VOLUME, vm.Coefficients(0, extinction), DOWN, 0.1, scheme=scheme)


@pytest.mark.parametrize("length", [1e-60, 1e60])
@pytest.mark.parametrize("size", [1e-200, 1.0, 1e200])
def test_measurements_do_not_depend_on_units(length, size):
    """Depths and columns are numbers of a size that single precision, or products, cannot hold."""
    camera = vm.Orthographic(37, 61, 20, width=2.4 * length, resolution=5, center=(0, 0, 0))
    values, plain = np.abs(VOLUME.array("a")), vm.Orthographic(37, 61, 20, 2.4, 5, center=(0, 0, 0))
    large = vm.Volume(vm.CartesianGrid.uniform(8, (-length, length)), a=size * values)
    usual = vm.Volume(vm.CartesianGrid.uniform(8, (-1, 1)), a=values)

    def measured(volume, camera, size, length):
        found = vm.project(volume, "a", camera, depth=True)
        yield found[0].intensity / size
        yield found[1].intensity / length
        yield vm.project(volume, f"a > {size!r}", camera, "first").intensity / length
        for method in ("rays", "exact"):
            yield vm.column(volume, "a", camera, method=method).intensity / size / length
        medium = vm.Coefficients(0, f"a * {1 / size / length!r}")
        for precision in ("single", "double"):
            surface = vm.tau_surface(volume, medium, camera, 0.3, precision=precision)
            yield surface.depth.intensity / length

    scaled, expected = measured(large, camera, size, length), measured(usual, plain, 1.0, 1.0)
    for pair in zip(scaled, expected, strict=True):
        np.testing.assert_allclose(*pair, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("measured", "message"),
    [
        (lambda: vm.project(VOLUME, "a > 0", DOWN, "first", progress=3), "progress must be True"),
        (
            lambda: vm.tau_surface(VOLUME, vm.Coefficients(0, "a"), DOWN, 0),
            "tau must be",
        ),
        (lambda: vm.project(VOLUME, "a", DOWN, "maxx"), "did you mean 'max'"),
        (lambda: vm.project(VOLUME, "a", DOWN, "mean", depth=True), "depth=True is for"),
        (lambda: vm.project(VOLUME, "log10(-abs(a))", DOWN), "has no value in any cell"),
        (lambda: vm.project(VOLUME, "rho > 3 K", DOWN, "first"), "'3 K' is in K, expected"),
        (lambda: vm.moments(VOLUME, "rho", DOWN, "v", 5), "n, the highest moment"),
        (lambda: vm.moments(VOLUME, "rho", DOWN, "w"), "unknown field 'w'"),
        (lambda: vm.first_hit, r"vm\.project\(\.\.\., how='first'"),
    ],
)
def test_what_makes_no_sense(measured, message):
    with pytest.raises((vm.VoluminousError, AttributeError), match=message):
        measured()


@pytest.mark.parametrize(
    ("how", "unit", "factor"),
    [("max", "kg / m3", 1e3), ("integral", "kg / m2", 10.0), ("first", "m", 1e-2)],
)
def test_every_projection_is_in_the_unit_that_is_asked_for(how, unit, factor):
    grid = vm.CartesianGrid.uniform(4, (-1, 1), unit="cm")
    values = np.arange(1.0, 65.0).reshape(grid.shape)
    volume = vm.Volume(grid, density=values * u.g / u.cm**3)
    what = "density > 3 g/cm3" if how == "first" else "density"
    camera = vm.Orthographic(width=2, resolution=4)
    own = vm.project(volume, what, camera, how=how)
    other = vm.project(volume, what, camera, how=how, unit=unit)
    assert u.Unit(other.intensity_unit) == u.Unit(unit)
    assert np.allclose(other.intensity, own.intensity * factor, rtol=1e-6, equal_nan=True)
    with pytest.raises(vm.errors.UnitsError, match=r"is in .*, which is not K"):
        vm.project(volume, what, camera, how=how, unit="K")
