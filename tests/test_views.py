"""Views by name: of patients, and of stacks of pictures."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import voluminous as vm

EMISSION = vm.Coefficients("a", 0)
N = 8
# What is seen to the right and upwards in each view.
SEEN = {
    "anterior": "LS",
    "posterior": "RS",
    "left": "PS",
    "right": "AS",
    "superior": "RA",
    "inferior": "LA",
}
OPPOSITE = dict(zip("LRPASI", "RLAPIS", strict=True))
RIGHT_HANDED = [
    "".join(code)
    for order in itertools.permutations(("LR", "PA", "SI"))
    for code in itertools.product(*order)
    if np.linalg.det(
        [[("LPS".find(c) == k) - ("RAI".find(c) == k) for k in range(3)] for c in code]
    )
    > 0
]


def volume_with(**meta):
    grid = vm.CartesianGrid.uniform(N, (-1, 1))
    volume = vm.Volume(grid, a=np.full(grid.shape, 0.05))
    volume.meta.update(meta)
    return volume


def marked(code, letter):
    """Return a volume in which the side of the patient with a letter is bright."""
    volume = volume_with(orientation=code)
    a = volume.array("a").copy()
    axis = next(k for k, c in enumerate(code) if c in (letter, OPPOSITE[letter]))
    side = slice(N - 2, N) if code[axis] == letter else slice(0, 2)
    a[tuple(side if k == axis else slice(None) for k in range(3))] = 1.0
    volume["a"] = a
    return volume


def middle(image):
    """Return where the light is, in pixels from the middle, to the right and upwards."""
    light = image.intensity[..., 0].astype(float)
    y, x = (np.arange(n) - 0.5 * (n - 1) for n in light.shape)
    return float((light.sum(axis=0) * x).sum()), float((light.sum(axis=1) * y).sum())


@pytest.mark.parametrize("code", ["LPS", "RAS", "ASR", "IRP"])
@pytest.mark.parametrize("view", SEEN)
def test_sides_of_the_patient_are_where_they_belong(view, code):
    assert code in RIGHT_HANDED
    assert len(RIGHT_HANDED) == 24
    right, up = SEEN[view]
    for letter, axis in ((right, 0), (up, 1)):
        volume = marked(code, letter)
        angles = vm.Orthographic.framing(volume, EMISSION, view=view)
        image = vm.render(volume, EMISSION, angles.replace(resolution=16, width=2.0, shift=(0, 0)))
        moved = middle(image)
        assert moved[axis] > 10 * abs(moved[1 - axis])


@pytest.mark.parametrize("code", RIGHT_HANDED)
def test_the_observer_stands_on_the_side_of_the_name(code):
    for view, letter in zip(SEEN, "APLRSI", strict=True):
        volume = marked(code, letter)
        found = vm.project(
            volume, "a", vm.Orthographic.framing(volume, EMISSION, view=view), depth=True
        )[1]
        depth = found.intensity[..., 0]
        assert np.nanmean(depth) < 0  # in front of the plane through the middle


def test_a_stack_is_seen_as_it_is_leafed_through():
    volume = volume_with(y_down=True)
    a = volume.array("a").copy()
    a[:2, :2, :2] = 1.0  # column 0, row 0, the first picture
    volume["a"] = a
    camera = vm.Orthographic.framing(volume, EMISSION, view="stack", resolution=16)
    right, up = middle(vm.render(volume, EMISSION, camera.replace(width=2.0, shift=(0, 0))))
    assert right < 0 < up
    depth = vm.project(volume, "a > 0.5", camera, how="first").intensity
    assert np.nanmin(depth) == pytest.approx(-1.0)


def test_what_a_volume_tells_decides_the_first_picture():
    for meta, view in (
        ({"orientation": "RAS"}, "anterior"),
        ({"y_down": True}, "stack"),
        ({"orientation": "LPS", "y_down": True}, "anterior"),
    ):
        volume = volume_with(**meta)
        wanted = vm.Orthographic.framing(volume, EMISSION, view=view).describe()
        assert vm.Orthographic.framing(volume, EMISSION).describe() == wanted
        for image in (vm.render(volume, EMISSION), vm.render(volume, EMISSION, view=view)):
            assert {k: image.camera[k] for k in ("incl", "phi", "posang")} == {
                k: wanted[k] for k in ("incl", "phi", "posang")
            }
        assert vm.Orthographic.framing(volume, EMISSION, 20).incl == 20
    for meta in ({}, {"orientation": "LPX"}, {"orientation": "RPS"}):
        camera = vm.Orthographic.framing(volume_with(**meta), EMISSION)
        assert (camera.incl, camera.phi, camera.posang) == (60, 30, 0)


def test_what_makes_no_sense_is_refused():
    plain, patient = volume_with(), volume_with(orientation="LPS")
    with pytest.raises(vm.InputError, match=r"set volume.meta\['orientation'\] = 'LPS' if x"):
        vm.render(plain, EMISSION, view="left")
    with pytest.raises(vm.InputError, match=r"set volume.meta\['y_down'\] = True"):
        vm.Orthographic.framing(plain, EMISSION, view="stack")
    with pytest.raises(vm.errors.UnknownNameError, match="did you mean 'anterior'"):
        vm.render(patient, EMISSION, view="anterio")
    with pytest.raises(vm.InputError, match="give a camera or view='left', not both"):
        vm.render(patient, EMISSION, vm.Orthographic(), view="left")
    with pytest.raises(vm.InputError, match="give angles or view='left', not both"):
        vm.Orthographic.framing(patient, EMISSION, 0, view="left")
    for code in ("LP", "LLS", 3, ["L", "P", "S"], "LPX"):
        with pytest.raises(vm.InputError, match="must be three letters"):
            vm.render(volume_with(orientation=code), EMISSION, view="left")
    with pytest.raises(vm.InputError, match=r"'RPS' is left-handed: .* mirrored"):
        vm.render(volume_with(orientation="RPS"), EMISSION, view="left")
