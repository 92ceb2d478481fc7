"""A picture does not depend on the unit of light; opacities may be anything."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm

CELLS = np.random.default_rng(0).uniform(1, 9, (8, 8, 8))
CAMERA = vm.Orthographic(50, 30, resolution=16)
MEDIA = {
    "shell": lambda c: vm.Gaussian("a", 5, 0.05, c, 0.3, 0.1),
    "two": lambda c: (
        vm.Gaussian("a", 5, 0.2, c, 0.3, 0.1) + vm.Gaussian("a", 3, 0.2, 1e-3 * c, 0.3, 0.1)
    ),
    "channels": lambda c: vm.Gaussian("a", 5, 0.2, (c, 0.2 * c), (0.3, 0.5), 0.1),
    "rectangle": lambda c: vm.Rectangle("a", 5, 0.2, c, 0.3, 0.1),
    "table": lambda c: vm.Table("a", [3, 5, 7], [0, c, 0], [0, 1, 0], 0.1),
    "coefficients": lambda c: vm.Coefficients(f"{c!r}*a", "a"),
    "surface": lambda c: vm.Isosurface("a", 5, c, opacity=0.5),
    "both": lambda c: vm.Isosurface("a", 5, c, opacity=0.5) + vm.Gaussian("a", 3, 0.2, c, 0.3, 0.1),
}
SIZES = [1e-24, 1e-28, 1e-45, 1e-300, 1e30, 1e60, 1e300]


def volume():
    return vm.Volume(vm.CartesianGrid.uniform(8, (-1, 1)), a=CELLS)


def pictured(medium, **options):
    return vm.render(volume(), medium, CAMERA, **options)


@pytest.mark.each_value_once
@pytest.mark.parametrize("precision", ["single"])
@pytest.mark.parametrize("name", MEDIA)
def test_a_picture_is_only_brighter_or_fainter(name, precision):
    expected = pictured(MEDIA[name](1.0), precision=precision)
    brightest = expected.intensity.max()
    assert expected.error.max() > 1e-5 * brightest
    for size in SIZES:
        found = pictured(MEDIA[name](size), precision=precision)
        assert found.provenance["precision"] == precision
        for one, other in (
            (found.intensity, expected.intensity),
            (found.error, expected.error),
        ):
            # Rounding decides here and there which pixels are drawn again.
            np.testing.assert_allclose(one / size, other, rtol=0, atol=3e-4 * brightest)
        assert found.error.max() / size == pytest.approx(expected.error.max(), rel=0.3)


@pytest.mark.parametrize("size", [1e-60, 1e-30, 1.0, 1e30, 1e60])
@pytest.mark.parametrize("behind", [1e-60, 1e-30, 1.0, 1e30, 1e60])
def test_backgrounds_may_be_far_brighter_or_fainter(size, behind):
    medium = vm.Gaussian("a", 5, 0.2, size, 0.3, 0.1)
    bare = pictured(medium)
    image = pictured(medium, background=behind)
    exact = bare.intensity.astype(float) + bare.transparency.astype(float) * behind
    np.testing.assert_allclose(image.intensity, exact, rtol=0, atol=2e-3 * exact.max())
    assert 1e-6 * exact.max() < image.error.max() < 2e-3 * exact.max()


@pytest.mark.each_value_once
@pytest.mark.parametrize("opacity", [1e-30, 1e-10, 1e3, 1e5, 1e6, 1e10, 1e20, 1e40, 1e100, 1e250])
@pytest.mark.parametrize("name", ["gaussian", "coefficients"])
def test_opacities_may_be_anything(name, opacity):
    medium = (
        vm.Gaussian("a", 5, 0.05, 1, opacity, 0.1)
        if name == "gaussian"
        else vm.Coefficients("a", f"{opacity!r}*a")
    )
    image = pictured(medium)
    exact = pictured(medium, precision="double", tolerance=1e-4)
    brightest = exact.intensity.max()
    assert brightest > 0
    wrong = np.abs(image.intensity.astype(float) - exact.intensity)
    assert wrong.max() < 1.5e-3 * brightest
    # Shells a hundredth as wide as what noise changes by in a cell: 98 %.
    assert (wrong[..., 0] > image.error + exact.error).mean() < 0.02


def test_an_opaque_shell_shows_its_source_function():
    """Of a tail in which the optical depth is large anywhere, all that shows is j/α."""
    for opacity in (1e6, 1e10):
        image = pictured(vm.Gaussian("a", 5, 0.05, 1, opacity, 0.1))
        seen = image.transparency[..., 0] < 1e-4
        assert seen.mean() > 0.3
        np.testing.assert_allclose(image.intensity[seen] * opacity, 1, rtol=1e-3)


@pytest.mark.parametrize(("center", "sigma"), [(11, 0.3), (20, 1.2), (14, 0.5), (20, 0.8)])
def test_tails_of_shells_are_right_however_faint(center, sigma):
    shell = vm.Gaussian("a", center, sigma, 1, 0.3, 0.1)
    image, exact = pictured(shell), pictured(shell, precision="double", tolerance=1e-5)
    brightest = exact.intensity.max()
    assert 0 < brightest < 1e-11
    wrong = np.abs(image.intensity.astype(float) - exact.intensity)[..., 0]
    assert wrong.max() < 1e-2 * brightest
    assert (wrong > image.error + exact.error).mean() < 0.02


@pytest.mark.parametrize("length", [1e-40, 1e40])
def test_a_path_length_may_be_anything(length):
    image = pictured(vm.Gaussian("a", 5, 2, 1, 0, length))
    expected = pictured(vm.Gaussian("a", 5, 2, 1, 0, 1.0))
    brightest = expected.intensity.max()
    np.testing.assert_allclose(
        image.intensity * length, expected.intensity, rtol=0, atol=2e-3 * brightest
    )


@pytest.mark.parametrize("scheme", ["first-order", "second-order", "olson-kunasz"])
@pytest.mark.parametrize("opacity", [1e20, 1e40, 1e100])
def test_tables_of_opaque_media_are_in_double(scheme, opacity):
    medium = vm.Coefficients("a", f"{opacity!r}*a")
    image = pictured(medium, scheme=scheme)
    assert image.provenance["precision"] == "double"
    np.testing.assert_allclose(image.intensity.max() * opacity, 1, rtol=1e-6)
