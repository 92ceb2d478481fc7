"""Steps wider than a cell, where the fields are as smooth as the medium's structures are wide."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from contracts.bundle import box_limits, on_a_sphere
from contracts.grid import make_ray
from voluminous.backend import dr, get_backend
from voluminous.grids.cartesian.dual_walk import WIDEST
from voluminous.grids.cartesian.leap import BITS, BrickRays, make_bricks
from voluminous.media.bound import Binding
from voluminous.media.context import Context
from voluminous.media.profiles import BoundShaped
from voluminous.ranges import DUAL
from voluminous.schemes.pre_integrated import PreIntegrated

CAMERA = vm.Orthographic(50, 20, width=3.6, resolution=40)
numbers = st.integers(0, 2**32 - 1)


def random_steps(shape, seed):
    """Return steps of bricks: whole cubes of the widest, and any others."""
    rng = np.random.default_rng(seed)
    ratio = 1 << (WIDEST - BITS)
    wide = rng.uniform(size=[-(-n // ratio) for n in shape]) < 0.4
    for axis in range(3):
        wide = np.repeat(wide, ratio, axis=axis)
    steps = rng.integers(0, BITS + 1, shape).astype(np.uint8)
    steps[wide[tuple(slice(n) for n in shape)]] = WIDEST
    return steps


@pytest.mark.parametrize("precision", ["single"])
@given(cells=st.tuples(*(st.integers(1, 23),) * 3), share=st.sampled_from([0.3, 1.0]), seed=numbers)
@settings(max_examples=10)
def test_steps_of_any_width_add_up_and_stay_in_their_cubes(precision, cells, share, seed):
    backend, rng = get_backend("cpu", precision), np.random.default_rng(seed)
    grid = vm.CartesianGrid.uniform(cells, [(0, n) for n in cells])
    filled = rng.uniform(size=DUAL.shape(cells)) < share
    steps = random_steps(filled.shape, seed)
    bricks = make_bricks(filled, backend, steps)
    aims, directions = rng.uniform(0, cells, (48, 3)), on_a_sphere(48, seed)
    directions[:6] = np.vstack([np.eye(3), -np.eye(3)])
    origins = aims - 60 * directions
    walk = grid.walk(backend, "coarse")
    track, cursor = walk.enter(make_ray(backend, origins, directions))
    enter, leave = box_limits(grid.bounds, origins, directions)
    rounding = 200 * np.finfo(backend.dtype).eps
    total = np.zeros(48)
    while dr.any(cursor.inside):
        found = BrickRays(walk, track, bricks)(cursor)
        cursor = found.cursor
        dr.eval(found)
        segment, following = walk.next(track, cursor)
        chord = walk.chord(track, segment)
        here = np.asarray(cursor.inside)
        width = np.asarray(chord.width)
        # Cubes begin at multiples of their width.
        cell, _ = chord.at(0.5)
        inner = np.stack([np.asarray(i) for i in cell.index], axis=-1)
        base = (inner // width[:, None].astype(int)) * width[:, None].astype(int)
        middle = [p + 0.5 * d for p, d in zip(chord.position, chord.step, strict=True)]
        place = np.stack([np.asarray(p) for p in middle], axis=-1) + 0.5  # in dual cells
        off = np.maximum(base - place, place - base - width[:, None])[here]
        assert off.max(initial=0) <= 100 * rounding
        brick = tuple(np.clip(base[here] >> BITS, 0, np.array(filled.shape) - 1).T)
        expected = np.where(width[here] > 1 << BITS, WIDEST, steps[brick])
        np.testing.assert_array_equal(np.log2(width[here]), expected)
        total += np.where(here, np.asarray(segment.length), 0) * grid.scale
        cursor = dr.select(cursor.inside, following, cursor)
        dr.eval(cursor)
    if filled.all():
        chord = np.maximum(leave - enter, 0)
        np.testing.assert_allclose(total, chord, rtol=0, atol=rounding * 60)
    else:
        assert (total <= np.maximum(leave - enter, 0) + rounding * 60).all()


def shells(field):
    """Return a volume with a field of the coordinates, in 45 x 40 x 37 cells, and two shells."""
    grid = vm.CartesianGrid.uniform((45, 40, 37), (-1, 1))
    volume = vm.Volume(grid)
    volume["f"] = field
    medium = vm.Gaussian("f", 0.3, 0.1, [1, 0.2, 0.1], 0.5, 0.1)
    return volume, medium + vm.Gaussian("f", 0.7, 0.2, [0, 0.3, 1], 0.3, 0.1)


def drawn(scene, coarseness, **options):
    """Return a picture of one panel per segment."""
    return vm.render(*scene, CAMERA, scheme=PreIntegrated(coarseness), **options).intensity


@pytest.mark.parametrize("precision", ["single"])
def test_a_linear_field_is_crossed_in_wide_steps_without_error(precision):
    # Between the outermost centres of cells: beyond, it is constant, and bends.
    volume, medium = shells("0.5*x + 0.3*y - 0.4*z + 0.5")
    inner = vm.Orthographic(50, 20, width=1.0, resolution=30)
    options = {"precision": precision, "cutoff": 0}
    wide = vm.render(volume, medium, inner, scheme=PreIntegrated(0.01), **options)
    fine = vm.render(volume, medium, inner, scheme=PreIntegrated(0), **options)
    exact = vm.render(volume, medium, inner, precision="double", tolerance=1e-7, cutoff=0)
    most = exact.intensity.max()
    # A panel has a mean of j and of α, front and back mixed: what is dense is not crossed in wide
    # steps, not even where fields are linear.
    assert np.abs(fine.intensity - exact.intensity).max() < 0.02 * most
    assert np.abs(wide.intensity - exact.intensity).max() < 0.02 * most
    thin = vm.Gaussian("f", 0.3, 0.1, 1.0, 0.0, 0.1)
    pair = [
        vm.render(volume, thin, inner, scheme=PreIntegrated(c), **options).intensity
        for c in (0.01, 0)
    ]
    # Where the field bends, beyond the outermost centres, wings of shells may be off by more than
    # what the coarseness is of their peak, but by no more of what they show.
    np.testing.assert_allclose(pair[0], pair[1], rtol=0, atol=0.01 * pair[1].max())


@pytest.mark.parametrize(
    "medium",
    [
        vm.Gaussian("f", 0.5, 0.1, 1.0, 0.5, 0.1),
        vm.Rectangle("f", 0.5, 0.1, 1.0, 0.5, 0.1),
        vm.Table("f", [0.3, 0.5, 0.6, 0.9], [0, 1, 2, 0], [0, 1, 0.5, 0], 0.1),
    ],
    ids=lambda medium: type(medium).__name__,
)
def test_prominence_is_what_shows_of_the_peak(medium):
    context, bound = Context(dr.llvm.Float64, dr.llvm.Float64), medium.bind(Binding())
    x = np.linspace(0, 1, 101)
    found = bound.coefficients({"f": dr.llvm.Float64(x)}, context)
    shown = np.max(
        [np.asarray(v) / np.max(v) for v in (*found.emissivity, *found.extinction)], axis=0
    )
    prominence = np.asarray(bound.prominence(dr.llvm.Float64(x), context))
    # Of several columns the lines between the largest entries lie above the largest of the lines.
    assert (prominence >= shown - 1e-12).all()
    assert prominence.max() == pytest.approx(1, abs=1e-12)
    np.testing.assert_array_equal(prominence > 0, shown > 0)


def test_wings_of_shells_are_crossed_in_wide_steps_where_their_cores_are_not():
    # As many steps as with a limit twice as large everywhere, at less than its errors.
    scene = shells("x*x + y*y + 0.8*z*z")
    exact = vm.render(*scene, CAMERA, precision="double", tolerance=1e-6).intensity
    uneven = np.sqrt(np.mean((drawn(scene, 0.1) - exact) ** 2))

    class Even(BoundShaped):
        def prominence(self, x, context):
            return x * 0.0 + 1.0

    class Everywhere(vm.Gaussian):
        def bind(self, binding):
            return Even(self, binding)

        def key(self):
            return ("everywhere", *super().key())

    volume, medium = scene
    parts = [
        Everywhere("f", p.center, p.width, p.color, p.opacity, 0.1) for p in medium.components()
    ]
    even = np.sqrt(np.mean((drawn((volume, sum(parts)), 0.1) - exact) ** 2))
    assert 0 < uneven < 1.5 * even
