"""RADMC-3D's images: read as its documentation says, and written so that it could read them."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm

NX, NY = 5, 3
WAVES = [1300.0, 870.5]


def planes(parameters=1, seed=0):
    """Return intensities [wavelength, parameter, iy, ix]."""
    rng = np.random.default_rng(seed)
    shape = (len(WAVES), parameters, NY, NX)
    return rng.choice([1, -1], shape) * 10 ** rng.uniform(-30, 5, shape)


def text(number, values, size=(1e13, 2e13)):
    """Return an image as Fortran's list-directed output and E21.14 make it."""
    lines = [
        f"           {number}",
        f"  {NX}  {NY}",
        f"  {len(WAVES)}",
        f"  {size[0]!r} {size[1]!r}",
    ]
    lines += [f"{w:21.14E}" for w in WAVES] + [" "]
    for plane in values:
        lines += [
            " ".join(f"{x:21.14E}" for x in pixel) for pixel in plane.reshape(len(plane), -1).T
        ]
        lines.append(" ")
    return "\n".join(lines) + "\n"


def binary(number, values, size=(1e13, 2e13)):
    head = struct.pack("<4q", number, NX, NY, len(WAVES)) + struct.pack("<4d", *size, *WAVES)
    return head + b"".join(struct.pack("<d", x) for x in values.ravel())


@pytest.fixture(params=["text", "binary"])
def made(request, tmp_path):
    """Return a function that writes an image, and the digits that its numbers keep."""

    def make(number, values, size=(1e13, 2e13)):
        if request.param == "text":
            path = tmp_path / "image.out"
            path.write_text(text(number, values, size))
        else:
            path = tmp_path / "image.bout"
            path.write_bytes(binary(number, values, size))
        return path

    make.rounding = 1e-14 if request.param == "text" else 0
    return make


@pytest.mark.parametrize(("number", "parameters"), [(1, 1), (3, 4)])
def test_intensities_and_where_they_are(made, number, parameters):
    values = planes(parameters)
    image = vm.Image.load(made(number, values))
    assert image.shape == (NY, NX, 2 * parameters)
    # Row 0 is the bottom, in both; channels are I at all wavelengths, then Q, U and V.
    expected = values.transpose(2, 3, 1, 0).reshape(image.shape)
    np.testing.assert_allclose(image.intensity, expected, rtol=made.rounding)
    np.testing.assert_array_equal(image.x, np.array([-2, -1, 0, 1, 2]) * 1e13)
    np.testing.assert_array_equal(image.y, np.array([-1, 0, 1]) * 2e13)
    assert (image.unit, image.pixel_size) == ("cm", (1e13, 2e13))
    assert u.Unit(image.intensity_unit) == u.erg / (u.s * u.cm**2 * u.Hz * u.sr)
    assert image.provenance["wavelengths_micron"] == WAVES
    names = ["I 1300 micron", "I 870.5 micron", "Q 1300 micron"]
    assert image.provenance["channels"][:3] == names[: 2 * parameters]
    assert vm.Image.load(made(2, planes(), (1e-3, 1e-3))).unit == "rad"


@pytest.mark.parametrize("suffix", [".out", ".bout"])
@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_what_was_saved_comes_back(tmp_path, suffix, number):
    values = planes(4 if number > 2 else 1)
    (tmp_path / "first.bout").write_bytes(binary(number, values))
    image = vm.Image.load(tmp_path / "first.bout")
    image.save(tmp_path / f"again{suffix}")
    again = vm.Image.load(tmp_path / f"again{suffix}")
    np.testing.assert_array_equal(again.intensity, image.intensity)
    assert (again.unit, again.pixel_size) == (image.unit, image.pixel_size)
    assert again.provenance == image.provenance
    if suffix == ".bout":
        assert (tmp_path / "again.bout").read_bytes() == binary(number, values)


def test_a_picture_of_ours_becomes_one_of_radmc3d(tmp_path):
    image = vm.Image(np.ones((2, 3)), x=[0, 1, 2], y=[0, 1], unit="au")
    with pytest.raises(vm.InputError, match="wavelengths="):
        image.save(tmp_path / "image.out")
    image.save(tmp_path / "image.out", wavelengths=1.3 * u.mm)
    again = vm.Image.load(tmp_path / "image.out")
    assert again.provenance["wavelengths_micron"] == [pytest.approx(1300.0)]
    assert again.pixel_size[0] == pytest.approx(1.495978707e13, rel=1e-15)
    with pytest.raises(vm.InputError, match="one wavelength for each of 1 channels, got 2"):
        image.save(tmp_path / "image.out", wavelengths=[1, 2])
    for wave in (-1.0, 0.0, np.nan):
        with pytest.raises(vm.InputError, match="wavelengths must be positive and finite"):
            image.save(tmp_path / "image.out", wavelengths=wave)
    with pytest.raises(vm.UnitsError, match="a length or an angle"):
        vm.Image(np.ones((2, 3)), unit="s").save(tmp_path / "image.out", wavelengths=1)


def test_damage_is_named(made):
    path = made(1, planes())
    content = path.read_bytes()
    for part in (0.0, 0.05, 0.3, 0.9, 0.99):
        path.write_bytes(content[: int(part * len(content))])
        with pytest.raises(vm.FileFormatError, match=path.name):
            vm.Image.load(path)


@pytest.mark.parametrize("head", [(5, 5, 3, 2), (1, 0, 3, 2), (1, -5, -3, 2), (1, 5, 3, 2**40)])
def test_heads_that_cannot_be(tmp_path, head):
    path = tmp_path / "image.bout"
    path.write_bytes(struct.pack("<4q", *head) + bytes(8 * 34))
    with pytest.raises(vm.FileFormatError):
        vm.Image.load(path)
    path = tmp_path / "image.out"
    path.write_text("{}\n{} {}\n{}\n".format(*head) + "0.0\n" * 34)
    with pytest.raises(vm.FileFormatError):
        vm.Image.load(path)
