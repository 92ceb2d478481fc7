"""Tables of coefficients, kernels and the cut-off are for speed: they change nothing."""

from __future__ import annotations

import sys
import threading

import numpy as np
import pytest

import voluminous as vm
from contracts.scheme import coloured, random_volume
from voluminous.rendering.cache import Cache
from voluminous.rendering.sources.table import CoefficientTable
from voluminous.rendering.tolerance import Rounds
from voluminous.rendering.tracer import KernelCache
from voluminous.schemes import SCHEMES

OBLIQUE = vm.Orthographic(57, 213, 31, width=4.0, resolution=(15, 12))
INSIDE = vm.Perspective((0.2, 0.9, -0.4), (1, 2, 0.3), 100, resolution=12, projection="spherical")


def core(seed=0, shape=(6, 5, 4)):
    """Return noise with a unit, and coordinates that media may look at."""
    grid = vm.CartesianGrid.uniform(shape, (-1, 1))
    return vm.Volume(grid, f=aligned(np.random.default_rng(seed).uniform(size=shape)))


def aligned(values):
    """Return a copy that starts at a multiple of 128 bytes: Dr.Jit's kernels know if it does."""
    memory = np.empty(values.nbytes + 128, dtype="u1")
    start = -memory.ctypes.data % 128
    copy = memory[start : start + values.nbytes].view(values.dtype).reshape(values.shape)
    copy[...] = values
    return copy


def shell(color=(1.0, 0.3), opacity=2.0, sigma=0.1, center=0.5, path=1.0):
    return vm.Gaussian("f", center, sigma, color, opacity, path)


def picture(volume, medium, camera=OBLIQUE, **options):
    return vm.render(volume, medium, camera, **options).intensity


MEDIA = {
    "shapes": shell(),
    "two shapes": shell() + vm.Rectangle("f", 0.2, 0.1, (0.2, 0.9), 1.0, 1.0),
    "direct": vm.Coefficients(["f", "r"], ["f*x**2", "1 + y"]),
    "table": vm.Table("f", [0, 0.5, 1], [[0, 1], [1, 0], [2, 2]], [0, 1, 3], 1.0),
    "function": vm.Medium.from_function(lambda f, x: ([f, f * f], f * abs(x)), ["f", "x"], 2),
}


def test_a_large_volume_is_tabulated_only_when_that_pays():
    """The first picture takes each cell that rays visit as it is; the bits are the same."""
    x, y, z = np.ogrid[:168, :168, :168]
    field = (0.5 + 0.5 * np.sin(x / 9.0) * np.sin(y / 11.0) * np.sin(z / 13.0)).astype(np.float32)
    volume = vm.Volume(vm.CartesianGrid.uniform(field.shape, (-1, 1)), f=field)
    camera = OBLIQUE.replace(resolution=200)

    def drawn():
        image = picture(volume, shell(), camera, scheme="first-order")
        return image, sum(isinstance(made, CoefficientTable) for made, _ in volume.tables.values())

    (first, before), (second, after) = drawn(), drawn()
    assert (before, after) == (0, 1)
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", sorted(MEDIA))
def test_classifying_on_the_ray_gives_the_same_bits(name, precision, monkeypatch):
    options = {"scheme": "first-order", "precision": precision}
    volume = core(shape=(3, 3, 3))
    tabulated = picture(volume, MEDIA[name], **options)
    tables = [thing for thing, _ in volume.tables.values() if isinstance(thing, CoefficientTable)]
    assert len(tables) == 1
    monkeypatch.setattr("voluminous.rendering.sources.table.fits", lambda needed: False)
    fresh = core(shape=(3, 3, 3))
    np.testing.assert_array_equal(picture(fresh, MEDIA[name], **options), tabulated)
    assert not fresh.tables


def made(volume):
    """Return what is kept of a volume, but for plain numbers, and what belongs to cameras."""
    things = (thing for thing, _ in volume.tables.values())
    return {id(thing) for thing in things if not isinstance(thing, (tuple, KernelCache, Rounds))}


@pytest.mark.parametrize("scheme", sorted(SCHEMES))
def test_tables_are_used_again_and_never_stale(scheme):
    options = {"scheme": scheme}
    volume = core()
    own = np.array(volume.array("f"))
    volume["f"] = own
    first = picture(volume, shell(), **options)
    kept = made(volume)
    np.testing.assert_array_equal(picture(volume, shell(), INSIDE, **options).shape, (12, 12, 2))
    np.testing.assert_array_equal(picture(volume, shell(), **options), first)
    # The same table, not an equal one.
    assert kept
    assert made(volume) == kept

    def fresh(medium):
        return picture(vm.Volume(volume.grid, f=own), medium, **options)

    for medium in (shell(color=(0.1, 0.9)), shell(opacity=0.5), shell(sigma=0.2), shell(path=3.0)):
        np.testing.assert_array_equal(picture(volume, medium, **options), fresh(medium))
    own[2:, 1, 1] += 0.1  # in place: nobody is told
    changed = picture(volume, shell(), **options)
    assert (changed != first).any()
    np.testing.assert_array_equal(changed, fresh(shell()))


def test_a_large_lattice_leaves_room_for_pictures_in_turns(monkeypatch):
    """What a picture uses itself counts for nothing: bricks of 1e-3 do not drop those of None."""
    monkeypatch.setattr(Cache, "limit", 1 << 20)
    volume = vm.models.prestellar_core(40)  # packets of 4 × 40³ numbers are as large
    for tolerance in (None, 1e-3, None):
        vm.render(volume, vm.Gaussian("density", 1e4, 1e3, 1.0, 0.3, 1e17), tolerance=tolerance)
        kinds = [key[0] for key in volume.tables]
        assert kinds.count("bricks") == (1 if kinds.count("rounds") == 0 else 2)


def test_caches_are_limited_by_bytes():
    """A drag through centres drops the oldest tables; those of one picture stay together."""
    volume = core(shape=(3, 3, 3))
    picture(volume, shell(), scheme="first-order")
    assert any(isinstance(thing, CoefficientTable) for thing, _ in volume.tables.values())
    for k in range(12):
        cache = Cache(volume)
        for part in range(12 if k == 11 else 2):
            cache.put((k, part), np.zeros(64 << 20, np.uint8))  # which takes no memory
        if k < 11:
            others = [size for key, (_, size) in volume.tables.items() if key[0] != k]
            assert sum(others) <= 512 << 20
            latest = [(n, part) for n in range(max(0, k - 3), k + 1) for part in range(2)]
            assert [*volume.tables][-len(latest) :] == latest
    assert [*volume.tables][-12:] == [(11, part) for part in range(12)]


CASES = {
    "opaque noise": (random_volume(depth=30.0), OBLIQUE),
    "noise": (random_volume(depth=1.0), OBLIQUE),
    "inside": (random_volume(depth=10.0), INSIDE),
}


@pytest.mark.each_value_once
@pytest.mark.parametrize("scheme", sorted(SCHEMES))
@pytest.mark.parametrize("name", sorted(CASES))
@pytest.mark.parametrize("background", [0.0, 100.0])
def test_default_cutoff_is_unseen(name, scheme, background):
    volume, camera = CASES[name]
    exact, default = (
        vm.render(volume, coloured(), camera, scheme=scheme, background=background, **options)
        for options in ({"cutoff": 0}, {})
    )
    error = np.abs(default.intensity - exact.intensity).max()
    # The bound is 1e-4 of the maximum; with a tolerance both are off by a part of that, too.
    assert error <= (1e-3 if scheme == "post-classified" else 1e-4) * exact.intensity.max()
    # The optical depth is that of all that is there, cut-off or not.
    np.testing.assert_allclose(default.optical_depth, exact.optical_depth, rtol=1e-6)


def test_cutoff_is_a_transparency():
    volume = vm.models.uniform_slab(1.0, 20.0)
    finer = vm.Volume(
        vm.CartesianGrid([-0.5, 0.5], [-0.5, 0.5], np.linspace(0, 1, 201)),
        {k: np.full((1, 1, 200), volume.array(k).item()) for k in "ja"},
    )
    camera, medium = vm.Orthographic(width=0.5, resolution=1), vm.Coefficients("j", "a")
    for cutoff in (0.5, 0.1, 0.01):
        image = vm.render(finer, medium, camera, scheme="first-order", cutoff=cutoff)
        # It stops within two cells, of optical depth 0.1, of where it is told to.
        left = 1 - 20 * image.intensity.item()
        assert cutoff * np.exp(-0.25) < left <= cutoff


def test_pictures_of_two_threads_share_a_cache(monkeypatch):
    """Each looks through the entries, and drops some, while the other does."""
    monkeypatch.setattr(Cache, "limit", 1 << 27)
    volume, failed, interval = core(shape=(3, 3, 3)), [], sys.getswitchinterval()

    def draw(first):
        try:
            for k in range(600):
                cache = Cache(volume)
                assert cache.get_or_make(("kept", k % 7), lambda k=k: k % 7) == k % 7
                cache.put(("small", first, k), k)
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=draw, args=(k,)) for k in range(3)]
    sys.setswitchinterval(1e-6)
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert not failed
