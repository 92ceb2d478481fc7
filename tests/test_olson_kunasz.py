"""Scheme ``olson-kunasz``: RADMC-3D's second order and its branches."""

from __future__ import annotations

import numpy as np
import pytest

import reference
import voluminous as vm
from scenes import camera_of

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


@pytest.mark.parametrize("cutoff", [None, 0.5])
def test_the_cutoff_does_not_matter_in_double_precision(cutoff):
    expected = one_cell(1.0, 5.0)
    image = one_cell(1.0, 5.0, cutoff=cutoff)
    np.testing.assert_array_equal(image.intensity, expected.intensity)
    np.testing.assert_array_equal(image.optical_depth, expected.optical_depth)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_what_rounding_leaves_at_the_end_of_a_medium_is_nothing(precision):
    """S = j/α must not depend on whether 0 or 1e-17 of a medium is left where it ends.

    Otherwise units, mirrored cells or another order of sums change pixels by per cents.
    """
    axis = (np.arange(20) + 0.5) / 10 - 1
    r = np.sqrt(sum(c**2 for c in np.meshgrid(axis, axis, axis)))
    field = 0.7 * np.maximum(1 - r / 0.7, 0) + 0.1

    def drawn(left):
        alpha = np.maximum(0, field - 0.1 * (1 - left))
        volume = vm.Volume(
            vm.CartesianGrid.uniform(20, (-1, 1)), j=alpha * (2 + field), a=5 * alpha
        )
        camera = vm.Orthographic(30, 20, width=2, resolution=40)
        medium = vm.Coefficients("j", "a")
        options = {"scheme": "olson-kunasz", "precision": precision}
        return vm.render(volume, medium, camera, **options).intensity

    expected = drawn(0.0)
    for left in (2e-16, 1e-15):
        # 3e-3 before; what is left now is where all coefficients of a cell are that small
        np.testing.assert_allclose(drawn(left), expected, rtol=0, atol=1e-5 * expected.max())


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


@pytest.mark.each_value_once
@pytest.mark.parametrize(("name", "case_id"), second_order_cases("core", "random32", "nonuniform"))
def test_the_rule_is_radmcs(name, case_id):
    """With j and α given only the rule is compared, and the noise of RADMC-3D's rounding."""
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
    # One last bit of one path length that differs is 1e-9 in `core`.
    assert error < 1e-8
