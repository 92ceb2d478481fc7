"""Physics on the host: Planck's function, opacities, molecules and spectra."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scipy.integrate import trapezoid

from voluminous.errors import UnknownNameError
from voluminous.physics import CODATA, RADMC3D, constants_named

# Constants and Planck's function


@pytest.mark.parametrize("x", [1e-12, 1e-6, 0.3, 2.8, 30.0, 600.0])
def test_planck_keeps_all_digits(x):
    temperature = 20.0
    nu = x * temperature / CODATA.planck_exponent
    with mpmath.workdps(40):
        exponent = mpmath.mpf(CODATA.planck_exponent) * nu / temperature
        exact = mpmath.mpf(CODATA.planck_factor) * mpmath.mpf(nu) ** 3 / mpmath.expm1(exponent)
    # rounding of the exponent is amplified x times by the exponential
    assert CODATA.planck(nu, temperature) == pytest.approx(float(exact), rel=1e-15 * (4 + 2 * x))


def test_planck_has_its_limits():
    nu = 1e-9 / CODATA.planck_exponent
    rayleigh_jeans = 2.0 * nu**2 * CODATA.k / CODATA.c**2
    assert CODATA.planck(nu, 1.0) == pytest.approx(rayleigh_jeans * (1 - 0.5e-9), rel=1e-14)
    nu = 100.0 / CODATA.planck_exponent
    wien = 2.0 * CODATA.h * nu**3 / CODATA.c**2 * np.exp(-100.0)
    assert CODATA.planck(nu, 1.0) == pytest.approx(wien, rel=1e-13)


def test_planck_is_zero_where_nothing_shines():
    found = CODATA.planck([1e11, 1e11, 0.0, 1e30], [[0.0], [-5.0], [10.0]])
    assert found.shape == (3, 4)
    np.testing.assert_array_equal(found[:2], 0.0)
    assert found[2, 0] > 0.0
    np.testing.assert_array_equal(found[2, 2:], 0.0)


def test_the_integral_of_planck_is_that_of_stefan_and_boltzmann():
    x = np.linspace(0.0, 60.0, 60001)
    temperature = 5772.0
    nu = x * temperature / CODATA.planck_exponent
    flux = np.pi * trapezoid(CODATA.planck(nu, temperature), nu)
    sigma = 2 * np.pi**5 * CODATA.k**4 / (15 * CODATA.h**3 * CODATA.c**2)
    assert flux == pytest.approx(sigma * temperature**4, rel=1e-8)  # of the trapezoids


def test_digits_of_radmc3d():
    # they contradict each other by these amounts
    assert RADMC3D.planck_factor / (2 * RADMC3D.h / RADMC3D.c**2) - 1 == pytest.approx(
        1.4676e-5, abs=1e-8
    )
    assert RADMC3D.planck_exponent / (RADMC3D.h / RADMC3D.k) - 1 == pytest.approx(-5.4e-5, abs=1e-6)
    assert RADMC3D.boltzmann == 1.4387519359588623
    assert RADMC3D.partition == pytest.approx(1.4387519267, rel=1e-10)
    ratio = RADMC3D.planck(230.538e9, 20.0) / CODATA.planck(230.538e9, 20.0)
    assert ratio == pytest.approx(1.0, abs=2e-4)


def test_constants_have_names():
    assert constants_named("codata") is CODATA
    assert constants_named("radmc3d") is RADMC3D
    assert constants_named(RADMC3D) is RADMC3D
    with pytest.raises(UnknownNameError, match="did you mean 'codata'"):
        constants_named("coddata")
