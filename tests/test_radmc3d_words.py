"""RADMC-3D's words on the command line: what they ask for, and what is refused.

What each word means is said in RADMC-3D's manual, chapters on images, spectra and options.
"""

from __future__ import annotations

import pytest

import voluminous as vm
from radmc3d_cases import MODELS, stored_model
from voluminous.errors import UnknownNameError
from voluminous.radmc3d.words import AU, PARSEC, request_of


def asked(text):
    return request_of(text.split())


def test_a_picture_at_a_wavelength():
    request = asked("image lambda 870 incl 60 phi 30 posang -5 npix 400 sizeau 200")
    assert (request.command, request.channels, request.wavelength) == ("image", "lambda", 870.0)
    assert (request.incl, request.phi, request.posang) == (60.0, 30.0, -5.0)
    assert (request.nx, request.ny) == (400, 400)
    assert request.half_size == (100 * AU, 100 * AU)
    assert request.dust is request.lines is request.stars is None  # as radmc3d.inp says


def test_numbers_are_fortrans():
    assert asked("image lambda 1.d2").wavelength == asked("image lambda 100.").wavelength == 100.0


def test_a_line():
    """A width without a number of channels has 40 of them; channels without a width, 10 km/s."""
    request = asked("spectrum iline 2 widthkms 5")
    assert (request.channels, request.iline, request.lines) == ("iline", 2, True)
    assert (request.linenlam, request.widthkms) == (40, 5.0)
    request = asked("image imolspec 2 iline 3 linenlam 7 vkms -1.5")
    assert (request.imolspec, request.linenlam, request.widthkms) == (2, 7, 10.0)
    assert (asked("image iline 1").linenlam, asked("image iline 1 vkms 2").vkms) == (1, 2.0)


def test_a_later_word_overrides():
    assert asked("image lambda 1 lambda 2 npix 10 npixy 20").ny == 20
    assert asked("image iline 1 noline lambda 5").channels == "lambda"
    assert asked("image lambda 5 nostar inclstar").stars is True
    assert not asked("image lambda 5 locobsau 1 2 3 sizeradian 0.5 incl 30").local


@pytest.mark.parametrize("first", ["doppcatch secondorder", "secondorder dcatch", "doppcatch"])
def test_catching_is_of_second_order(first):
    request = asked(f"image iline 1 {first}")
    assert request.second
    assert request.catching


def test_other_names_of_words():
    request = asked("image inu 3 theta 40 norefine imageunform second")
    assert (request.channels, request.ilambda, request.incl) == ("ilambda", 3, 40.0)
    assert request.refine == -1
    assert request.binary
    assert request.second
    assert asked("image nuhz 3.e11").wavelength == pytest.approx(999.308193, rel=1e-9)


def test_free_free_is_recognised():
    """RADMC-3D 2.0 never recognises inclfreefree: it compares 11 letters with 12."""
    assert asked("image lambda 1e4 inclfreefree").freefree is True


def test_a_zoom_has_square_pixels():
    request = asked("image lambda 10 npix 60 zoomau -10 -4 0 3.1415")
    side = 6 * AU / 60
    assert (request.nx, request.ny) == (60, 31)
    assert request.half_size == pytest.approx((3 * AU, 0.5 * 31 * side))
    assert request.middle == pytest.approx((-7 * AU, 0.5 * 3.1415 * AU))
    exact = asked("image lambda 10 npix 60 zoomau -10 -4 0 3.1415 truezoom")
    assert exact.ny == 31
    assert exact.half_size[1] == pytest.approx(0.5 * 3.1415 * AU)
    oblong = asked("image lambda 10 npixx 60 npixy 4 zoomau -10 -4 0 3.1415 truepix")
    assert (oblong.nx, oblong.ny) == (60, 4)
    assert asked("image lambda 10 zoompc 0 1 0 1").middle == (0.5 * PARSEC, 0.5 * PARSEC)


def test_a_local_observer():
    request = asked("image lambda 10 locobsau 1 -2 3 pointau 0 0 1 sizeradian 0.8 projection 2")
    assert request.local
    assert request.observer == (AU, -2 * AU, 3 * AU)
    assert request.half_size == (0.4, 0.4)
    assert request.projection == 2
    assert request.point == (0.0, 0.0, AU)


def test_an_sed_and_an_aperture():
    request = asked("sed noline useapert dpc 140 incl 45")
    assert (request.command, request.channels) == ("spectrum", "sed")
    assert request.aperture
    assert request.dpc == 140.0
    assert asked("tausurf 0.5 lambda 10").depth == 0.5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("image lambda 10 sizau 5", "unknown word 'sizau'; did you mean 'sizeau'"),
        ("image lamda 10", "did you mean 'lambda'"),
    ],
)
def test_an_unknown_word_is_refused_by_name(text, message):
    with pytest.raises(UnknownNameError, match=message):
        asked(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("image lambda 10 iline 2", "lambda and iline choose channels in 2 ways"),
        ("image lambda 10 loadlambda", "lambda and loadlambda"),
        ("sed lambda 10", "lambda and sed"),
        ("image loadlambda allwl", "loadlambda and allwl"),
        ("image incl 60", "no word chooses channels"),
        ("mctherm", "mctherm needs Monte Carlo"),
        ("image lambda 10 stokes", "Monte Carlo"),
        ("image lambda 10 inclscat", "Monte Carlo"),
        ("image lambda 10 vtk_dust_density 1", "vm.open"),
        ("incl 60 lambda 10", "give one of the commands image, spectrum, sed, tausurf; got none"),
        ("image spectrum lambda 10", "got image and spectrum"),
        ("image lambda", "lambda is followed by 1 number, but nothing comes after it"),
        ("image lambda 10 pointau 1 2", "pointau is followed by 3 numbers, but 2 come"),
        ("image lambda ten", "lambda expects a number, got 'ten'"),
        ("image ilambda 1.5", "ilambda expects a whole number"),
        ("image lambda -3", "lambda must be positive"),
        ("image lambda 10 npix 0", "npix must be positive"),
        ("image lambda 10 nlam 5", "give that too"),
        ("image lambda 10 zoomau 1 -1 0 1", "left, right, lower and upper"),
        ("image lambda 10 sizeradian 0.5", "say where it is: locobsau"),
        ("image lambda 10 locobsau 1 2 3", "needs its size: sizeradian"),
        ("spectrum lambda 10 locobsau 1 2 3 sizeradian 1", "observer at infinity"),
        ("spectrum lambda 10 useapert", "needs the distance"),
        ("image lambda 10 circ", "circ is for spectra"),
        ("spectrum lambda 10 tracetau", "for images"),
        ("image --model x", "comes before"),
    ],
)
def test_what_cannot_be_done_is_refused_in_words(text, message):
    with pytest.raises(vm.InputError, match=message):
        asked(text)


@pytest.mark.parametrize("name", MODELS)
def test_the_words_of_every_reference_are_known(name):
    _, meta = stored_model(name)
    for case in meta["cases"]:
        if case["quantity"] == "circular_image":
            continue
        request = asked(case["arguments"])
        camera = case["camera"]
        if "half_size" in camera and request.half_size is not None:
            assert request.half_size == pytest.approx(camera["half_size"], rel=1e-12)
            assert (request.nx, request.ny) == (camera["nx"], camera["ny"])
        line = case.get("line") or {}
        assert (request.iline, request.linenlam) == (line.get("iline"), line.get("n", 1))
        assert request.catching == case["doppler_catching"]
        assert request.second == (case["order"] == 2)
