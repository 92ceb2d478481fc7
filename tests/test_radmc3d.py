"""Against images of the real RADMC-3D: every Cartesian case."""

from __future__ import annotations

import numpy as np
import pytest

import reference
import scenes
import twin
import voluminous as vm

MODELS = ("random32", "box_40x24x30", "nonuniform", "direct20", "background_1ch", "core")


def cases(order):
    """Return the cases of that order: surfaces of given depth and interpolated S are not here."""
    chosen = []
    for parameter in reference.cartesian_cases():
        name, case_id = parameter.values
        case = reference.load_model(name).cases[case_id] if name else None
        known = case is None or (case.quantity != "tausurf" and not case.interpolates_source)
        if known and (case is None or case.order == order):
            chosen.append(parameter)
    return chosen


def render(model, case, scheme, *, as_radmc3d=True, **options):
    """Return what corresponds to a reference image."""
    # RADMC-3D carries j/α, and S τ is 0 where α is exactly 0: it is silently dark there.
    volume = scenes.volume_of(model, emit_without_extinction=not as_radmc3d)
    image = vm.render(
        volume,
        scenes.medium_of(model),
        scenes.camera_of(case),
        scheme=scheme,
        background=case.background,
        antialias="radmc3d" if case.camera["fluxcons"] else None,
        **{"precision": "double", "cutoff": 0, **options},
    )
    return image.optical_depth if case.quantity == "tau" else image.intensity


def difference(found, expected):
    """Return the largest difference over the maximum."""
    return np.abs(found - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize(("name", "case_id"), cases(1))
def test_first_order_is_radmc3d(name, case_id):
    model = reference.load_model(name)
    case = model.cases[case_id]
    # For τ <= 1e-4 RADMC-3D takes 1 - exp(-τ) = τ: its own error, up to 5e-5 of a segment. Sums
    # of α s have no such branch.
    tolerance = 1e-12 if case.quantity == "tau" or not model.j.any() else 2e-5
    assert difference(render(model, case, "first-order"), case.image) <= tolerance


@pytest.mark.parametrize(("name", "case_id"), cases(2))
def test_olson_kunasz_is_radmc3d(name, case_id):
    model = reference.load_model(name)
    case = model.cases[case_id]
    # τ - (1 - exp(-τ)) by subtraction near τ = 1e-6 loses all but 4 digits, in RADMC-3D and here.
    tolerance = 1e-12 if case.quantity == "tau" else 1e-8
    assert difference(render(model, case, "olson-kunasz"), case.image) <= tolerance


@pytest.mark.parametrize(
    ("name", "case_id"),
    [
        ("core", "first_obl1"),
        ("random32", "first_edge"),
        ("random32", "local_proj2_zenith"),
        ("nonuniform", "first_obl2"),
        ("direct20", "first_obl"),
        ("background_1ch", "first_fluxcons"),
    ],
)
def test_first_order_is_the_twin_to_rounding(name, case_id):
    """What differs from RADMC-3D is its branch for small depths: the twin has it switched off."""
    model = reference.load_model(name)
    case = model.cases[case_id]
    camera = twin.Camera.from_case(case)
    stride = 7 if name == "core" else 1  # NumPy is slow
    pixels = tuple(np.ogrid[: camera.ny : stride, : camera.nx : stride])
    expected = twin.render(
        model.edges,
        model.j,
        model.alpha,
        camera,
        "first-order",
        background=case.background,
        samples="flux-conserving" if case.camera["fluxcons"] else 1,
        pixels=pixels,
    )["intensity"]
    found = render(model, case, "first-order", as_radmc3d=False)[pixels]
    assert difference(found, expected) <= 1e-12


@pytest.mark.each_value_once
@pytest.mark.parametrize("scheme", ["first-order", "second-order", "olson-kunasz"])
@pytest.mark.parametrize("name", MODELS)
def test_single_precision_is_close_to_double(name, scheme):
    model = reference.load_model(name)
    case = next(c for c in model.cases.values() if c.quantity == "intensity" and c.order == 1)
    double, single = (render(model, case, scheme, precision=p) for p in ("double", "single"))
    assert difference(single, double) <= 5e-5
