"""A region as limits of rays: what is drawn, and measured, is what lies inside."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from astropy import units as u
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from test_objects import GRIDS
from test_streaming import MEDIUM, ahead, assert_same_bits, both, chunks, noise
from test_streaming_trees import GRIDS as TREES
from voluminous.backend import dr, get_backend
from voluminous.grids.contract import Ray
from voluminous.io.registry import open_lazily
from voluminous.measuring.columns import lines_of_sight
from voluminous.regions import Box, Clip, Cylinder, DoubleCone, HalfSpace, Sphere, region_of

__all__ = ["ahead", "chunks"]

CUBE = vm.CartesianGrid.uniform(4, (-2, 2))
BOX = Box((-1.1, -0.9, -1.3), (0.7, 1.2, 0.4))
ORTHOGRAPHIC = vm.Orthographic(40, 25, width=3.0, resolution=6)
SHELL = vm.Coefficients("a", "a")
FIRST, SECOND, DEFAULT = {"scheme": "first-order"}, {"scheme": "second-order"}, {}

coordinate = st.floats(-1.5, 1.5, width=16)
points = st.tuples(coordinate, coordinate, coordinate)
vectors = points.filter(lambda v: np.linalg.norm(v) > 0.1)
sizes = st.floats(0.125, 1.5, width=16)
solids = st.one_of(
    st.builds(
        lambda low, size: Box(low, np.add(low, size)), points, st.tuples(sizes, sizes, sizes)
    ),
    st.builds(Sphere, points, sizes),
    st.builds(HalfSpace, points, vectors),
    st.builds(lambda a, v, r: Cylinder(a, np.add(a, v), r), points, vectors, sizes),
    st.builds(
        DoubleCone,
        *(points, vectors, st.sampled_from([20.0, 45.0, 70.0, 90.0])),
        height=st.one_of(st.none(), sizes),
        side=st.sampled_from(["both", "up", "down"]),
    ),
)
regions = st.recursive(
    solids,
    lambda part: st.one_of(
        st.builds(lambda a: ~a, part),
        st.builds(lambda a, b: a & b, part, part),
        st.builds(lambda a, b: a | b, part, part),
    ),
    max_leaves=3,
)


@settings(max_examples=20, deadline=None)  # each is a kernel
@given(regions, st.integers(0, 99))
def test_stretches_of_rays_are_where_their_points_are_inside(region, seed):
    rng = np.random.default_rng(seed)
    origin, direction = rng.choice([-1.0, -0.5, 0.0, 0.25, 1.0], (2, 3, 64))
    direction[:, ::2] += rng.normal(0, 1, (3, 32))  # the others are along axes and diagonals
    direction[:, np.linalg.norm(direction, axis=0) < 0.1] = 1.0
    direction /= np.linalg.norm(direction, axis=0)
    backend = get_backend("cpu", "double")
    clip = Clip(region, CUBE)
    ray = Ray(*([backend.Wide(c) for c in vector] for vector in (origin, direction)))
    cut = clip.cut(ray, clip.traced(backend))
    ends = [end for one in cut.stretches or [(cut.first, cut.last)] for end in one]
    dr.eval(ends)
    ends = np.array([np.broadcast_to(end, 64) for end in ends])
    t = np.linspace(-6.0, 6.0, 401)
    place = (origin[:, :, None] + direction[:, :, None] * t).reshape(3, -1)
    within = ((ends[::2, :, None] < t) & (t < ends[1::2, :, None])).sum(axis=0)
    assert within.max() <= 1  # in no place twice
    # On a surface, to rounding, either is right.
    away = np.abs(region.beyond(place, None).reshape(within.shape)) > 1e-6
    assert np.array_equal(within[away], region.inside(place, None).reshape(within.shape)[away])
    # In order along the ray.
    for one in ends.T.reshape(64, -1, 2):
        assert np.all(np.diff(one[one[:, 0] < one[:, 1]].ravel()) >= 0.0)


@given(regions)
def test_the_text_of_a_region_is_read_as_the_region(region):
    again = region_of(str(region))
    place = np.random.default_rng(0).uniform(-2, 2, (3, 200))
    np.testing.assert_array_equal(again.inside(place, None), region.inside(place, None))


@pytest.mark.parametrize("options", [{"scheme": "first-order"}, {}], ids=["first", "default"])
@pytest.mark.parametrize("region", [BOX, ~BOX, BOX & ~Sphere((0, 0, 0), 0.5)], ids=str)
def test_chunks_have_the_bits_of_the_whole(region, options, chunks):
    chunks(4)
    grid = vm.CartesianGrid.uniform(8, (-2, 2))
    assert_same_bits(*both(noise(grid), MEDIUM, ORTHOGRAPHIC, clip=region, **options))


def test_chunks_outside_are_not_read(chunks, ahead):
    chunks(4)
    volume = noise(vm.CartesianGrid.uniform(16, (-2, 2)))
    corner = Box((0.1, 0.1, 0.1), (0.9, 1.9, 0.9))  # in two chunks of one unit
    vm.render(volume, MEDIUM, ORTHOGRAPHIC, clip=corner, memory="1 GiB", **FIRST)
    assert len(set(ahead)) == 2


def test_other_threads_and_kept_blocks_have_the_bits_of_the_whole(chunks, tmp_path):
    chunks(4)
    volume, region = noise(vm.CartesianGrid.uniform(8, (-2, 2))), ~BOX
    whole = vm.render(volume, MEDIUM, ORTHOGRAPHIC, clip=region, **FIRST)
    with ThreadPoolExecutor(2) as executor:
        for options in ({"executor": executor}, {"checkpoint": tmp_path / "blocks"}):
            parts = vm.render(volume, MEDIUM, ORTHOGRAPHIC, clip=region, **options, **FIRST)
            assert_same_bits(whole, parts)
    probes = [
        vm.probe(volume, MEDIUM, ORTHOGRAPHIC, (3, 3), clip=region, tolerance=None, memory=memory)
        for memory in (None, "1 GiB")
    ]
    np.testing.assert_array_equal(probes[1].begin, probes[0].begin)
    np.testing.assert_array_equal(probes[1].intensity, probes[0].intensity)


@pytest.mark.parametrize("name", TREES)
def test_parts_of_trees_have_the_bits_of_the_whole(name, monkeypatch):
    monkeypatch.setattr("voluminous.store.FieldStore.leaves", 4**3)
    monkeypatch.setattr("voluminous.large.view.VolumeView.widest", 4)
    grid = TREES[name]
    middle, width = grid.bounds.mean(axis=1), np.ptp(grid.bounds, axis=1)
    region = ~Box(middle - 0.2 * width, middle + 0.3 * width)
    camera = vm.Orthographic(35, 50, resolution=6)
    values = np.random.default_rng(1).uniform(0, 1, grid.size).astype(np.float32)
    volume = vm.Volume(grid, a=values)
    assert_same_bits(*both(volume, MEDIUM, camera, clip=region, scheme="first-order"))


# --- physics --------------------------------------------------------------------------------------


def drawn(volume, clip, camera=ORTHOGRAPHIC, medium=SHELL, **options):
    """Return intensity, transparency and optical depth of a picture, in double precision."""
    image = vm.render(volume, medium, camera, clip=clip, **{"precision": "double", **options})
    return image.intensity, image.transparency, image.optical_depth


@pytest.mark.parametrize("options", [FIRST, SECOND, {"scheme": "olson-kunasz"}, DEFAULT], ids=str)
def test_a_sphere_cut_by_a_plane_has_the_depth_of_its_chords(options):
    """τ = κ · length exactly, for a uniform medium, wherever surfaces cut cells."""
    volume, radius, normal = vm.Volume(CUBE, a=np.full(CUBE.shape, 0.7)), 1.3, (0.6, 0.0, 0.8)
    _, _, depth = drawn(
        volume, Sphere((0, 0, 0), radius) & HalfSpace((0.1, 0, 0), normal), **options
    )
    origin, away = lines_of_sight(ORTHOGRAPHIC, CUBE)
    middle = -np.sum(origin * away, axis=-1)  # where a ray is nearest to the centre
    near = np.linalg.norm(origin + middle[..., None] * away, axis=-1)
    half = np.sqrt(np.maximum(radius**2 - near**2, 0.0))
    plane = -((origin - [0.1, 0, 0]) @ normal) / (away @ normal)
    ends = np.sort([middle - half, middle + half], axis=0)
    inside = away[0, 0] @ normal > 0  # rays go to the side that is left
    low, high = (
        (np.maximum(ends[0], plane), ends[1]) if inside else (ends[0], np.minimum(ends[1], plane))
    )
    np.testing.assert_allclose(depth[..., 0], 0.7 * np.maximum(high - low, 0.0), atol=1e-13)


@pytest.mark.parametrize("options", [FIRST, DEFAULT], ids=["first", "default"])
@pytest.mark.parametrize("name", GRIDS)
def test_what_is_in_front_of_a_plane_and_behind_it_compose_to_the_whole(name, options):
    """(b₁ + θ₁ b₂, θ₁ θ₂), in first order to rounding: cells are cut in exact parts."""
    grid = GRIDS[name]
    volume = vm.Volume(grid, a=np.random.default_rng(2).uniform(0, 1, grid.shape))
    camera = vm.Orthographic(40, 25, width=2.0, resolution=5)
    towards = -camera.lines_of_sight(np.zeros((3, 1)), grid)[:, 0]
    front = HalfSpace((0.03, -0.05, 0.02), towards)
    (b, theta, tau), (c, other, more), (whole, clear, depth) = (
        drawn(volume, clip, camera, **options) for clip in (front, ~front, None)
    )
    # The default scheme keeps each to 1e-3 of the brightest.
    within = 1e-12 if options else 2e-3 * whole.max()
    np.testing.assert_allclose(b + theta * c, whole, atol=within)
    np.testing.assert_allclose(theta * other, clear, atol=within if options else 2e-3)
    np.testing.assert_allclose(tau + more, depth, atol=within if options else 4e-3)
    assert 0 < tau.max() < depth.max()


def test_a_quarter_turn_of_volume_region_and_camera_changes_nothing():
    a = np.random.default_rng(4).uniform(0, 1, CUBE.shape)
    region = ~Box((-0.3, -1.5, -0.2), (1.1, 0.4, 2.5)) & ~Sphere((-1, 0.5, 0), 0.6)
    turned = ~Box((-0.4, -0.3, -0.2), (1.5, 1.1, 2.5)) & ~Sphere((-0.5, -1, 0), 0.6)
    before = drawn(vm.Volume(CUBE, a=a), region, vm.Orthographic(50, 20, resolution=6))
    other = vm.Volume(CUBE, a=np.rot90(a, axes=(0, 1)))
    after = drawn(other, turned, vm.Orthographic(50, 20 - 90, resolution=6))
    np.testing.assert_allclose(after[0], before[0], rtol=1e-5)


def test_of_a_surface_what_is_inside_is_drawn():
    """A ray through the middle of a shell meets it twice; from the cut, once."""
    grid = vm.CartesianGrid.uniform(16, (-1, 1))
    volume = vm.Volume(grid)
    medium = vm.Isosurface("r", 0.6, (1, 1, 1), opacity=0.5)
    camera = vm.Orthographic(0, 0, width=0.1, resolution=2)
    shown = [
        drawn(volume, c, camera, medium)[1].mean() for c in (None, HalfSpace((0, 0, 0), (0, 0, 1)))
    ]
    np.testing.assert_allclose(shown, [0.25, 0.5], rtol=1e-6)


def test_objects_stay_and_are_dimmed_by_what_is_left():
    volume = vm.Volume(CUBE, a=np.full(CUBE.shape, 0.5))
    camera = vm.Orthographic(0, 0, width=1, resolution=3)
    star = vm.Stars([(0, 0, 0)], luminosities=[1.0], colors=1.0)
    medium = vm.Coefficients(0, "a")

    def light(clip):
        return vm.render(volume, medium, camera, objects=[star], clip=clip).intensity.sum()

    whole, cut = light(None), light(HalfSpace((0, 0, 0.5), (0, 0, -1)))  # seen from above
    bare, gone = light(HalfSpace((0, 0, 0), (0, 0, -1))), light(Box((1, 1, 1), (2, 2, 2)))
    assert bare > 0
    np.testing.assert_allclose([whole, cut, gone], bare * np.exp([-1.0, -0.25, 0.0]), rtol=1e-6)


# --- measuring ------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["rays", "exact"])
def test_columns_and_totals_of_both_sides_add_up(method):
    volume = vm.Volume(CUBE, a=np.random.default_rng(5).uniform(0, 1, CUBE.shape))
    whole, inside, outside = (
        vm.column(volume, "a", ORTHOGRAPHIC, method=method, clip=c, precision="double").intensity
        for c in (None, BOX, ~BOX)
    )
    np.testing.assert_allclose(inside + outside, whole, rtol=1e-12)
    assert inside.max() > 0
    total = [vm.measure(volume, "a", clip=c)["a"] for c in (None, BOX, ~BOX)]
    np.testing.assert_allclose(total[1] + total[2], total[0], rtol=1e-12)
    if method == "exact":  # its cells count as those of totals
        camera = vm.Orthographic(40, 25, resolution=6)
        found = vm.column(volume, "a", camera, method=method, clip=BOX)
        np.testing.assert_allclose(found.intensity.sum() * found.pixel_area, total[1], rtol=1e-12)


def test_projections_of_a_box_of_cells_are_those_of_the_cropped_volume():
    volume = vm.Volume(CUBE, a=np.random.default_rng(6).uniform(0, 1, CUBE.shape))
    camera, box = ORTHOGRAPHIC.replace(center=(0, 0, 0)), Box((-1, 0, -2), (1, 2, 1))
    part = volume.crop(x=(-1, 1), y=(0, None), z=(-2, 1))
    assert part.grid.bounds.tolist() == [[-1, 1], [0, 2], [-2, 1]]
    for how in ("max", "min", "mean", "integral"):
        clipped = vm.project(volume, "a", camera, how, clip=box).intensity
        np.testing.assert_allclose(clipped, vm.project(part, "a", camera, how).intensity, atol=1e-6)
    # Of several stretches the extremes are those of all.
    low, high = (
        vm.project(volume, "a", camera, how, clip=~box).intensity for how in ("min", "max")
    )
    each = vm.project(volume, "a", camera, "max", clip=box).intensity
    whole = vm.project(volume, "a", camera, "max").intensity
    np.testing.assert_array_equal(np.fmax(high, each), whole)
    assert np.all(low[~np.isnan(low)] <= high[~np.isnan(high)])
    first = vm.project(volume, "a > 0", camera, "first", clip=box).intensity
    np.testing.assert_allclose(
        first, vm.project(part, "a > 0", camera, "first").intensity, atol=1e-6
    )


def test_a_probe_and_a_depth_begin_at_the_cut():
    volume = vm.Volume(CUBE, a=np.full(CUBE.shape, 0.5))
    camera, cut = vm.Orthographic(0, 0, width=1, resolution=3), HalfSpace((0, 0, 0.7), (0, 0, -1))
    probe = vm.probe(volume, SHELL, camera, (1, 1), clip=cut, scheme="first-order")
    np.testing.assert_allclose([probe.begin[0], probe.end[-1]], [-0.7, 2.0], atol=1e-6)
    np.testing.assert_allclose(probe.depth[-1], 0.5 * 2.7, rtol=1e-6)
    hollow = ~Box((-1, -1, -0.3), (1, 1, 0.4)) & cut
    probe = vm.probe(volume, SHELL, camera, (1, 1), clip=hollow)
    np.testing.assert_allclose(probe.optical_depth, 0.5 * 2.0, rtol=1e-6)
    surface = vm.tau_surface(volume, SHELL, camera, 0.5, clip=hollow)  # 0.3 before the gap
    np.testing.assert_allclose(surface.depth.intensity, 0.3 + 0.7, rtol=1e-9)


def test_telescopes_see_what_is_inside():
    core = vm.models.prestellar_core(16)
    dust = vm.Dust("density * 2e-26 g", 15.0, vm.Opacity.power_law(3.5, 870.0, 1.8))
    camera = vm.Orthographic(90, 0, resolution=8)
    half = HalfSpace((0, 0, 0), (1, 0, 0))
    options = {"wavelengths": [870.0], "scheme": "first-order"}
    whole, left, right = (
        vm.observe(core, dust, camera, clip=c, **options).intensity for c in (None, half, ~half)
    )
    np.testing.assert_allclose(left + right, whole, rtol=1e-5)  # seen from the side of the cut
    assert not left[:, :4].any()
    assert not right[:, 4:].any()
    options |= {"camera": camera, "distance": "140 pc", "tolerance": None}
    whole, left, right = (
        vm.spectrum(core, dust, clip=c, **options).flux for c in (None, half, ~half)
    )
    np.testing.assert_allclose(left + right, whole, rtol=1e-5)
    assert left[0] > 0


# --- what users give ------------------------------------------------------------------------------


def test_the_length_of_a_normal_is_nothing():
    """Squares of tiny and of huge numbers are 0 and infinite."""
    volume = vm.Volume(CUBE, a=np.random.default_rng(7).uniform(0, 1, CUBE.shape))
    for size in (1e-300, 1e200):
        clips = [HalfSpace((0.1, 0, 0), (3 * c, 0, 4 * c)) for c in (1, size)]
        unit, other = (vm.measure(volume, "a", clip=c)["a"] for c in clips)
        np.testing.assert_allclose(other, unit, rtol=1e-12)
        unit, other = (drawn(volume, c, **FIRST)[0] for c in clips)
        np.testing.assert_allclose(other, unit, atol=1e-12)


def test_kept_work_is_that_of_a_clip():
    """Rounds, kernels and tables are kept with a volume: another clip is another picture."""
    grid = vm.CartesianGrid.uniform(8, (-1, 1))
    clips = [HalfSpace((x, 0, 0), (1, 0, 0)) for x in (-0.5, 0.1, 0.6)]
    volume = noise(grid)
    again = [vm.render(volume, MEDIUM, ORTHOGRAPHIC, clip=c).intensity for c in clips * 2]
    for k, clip in enumerate(clips):
        fresh = vm.render(noise(grid), MEDIUM, ORTHOGRAPHIC, clip=clip).intensity
        np.testing.assert_array_equal(again[k], fresh)
        np.testing.assert_array_equal(again[k + 3], fresh)
    assert vm.render(volume, MEDIUM, ORTHOGRAPHIC, clip=clips[0]).provenance["clip"] == str(
        clips[0]
    )


def test_a_region_beside_the_volume_leaves_nothing_and_says_so():
    volume = noise(CUBE)
    with pytest.warns(UserWarning, match=r"clip=sphere\(\(9, 0, 0\), 1\) may leave nothing"):
        image = vm.render(volume, MEDIUM, ORTHOGRAPHIC, clip=Sphere((9, 0, 0), 1))
    assert not image.intensity.any()
    assert np.all(image.transparency == 1)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (3, "clip must be one of vm.regions"),
        (Sphere, "clip must be one of vm.regions"),
        ("spere((0, 0, 0), 1)", "did you mean 'sphere'"),
        ("sphere((nan, 0, 0), 1)", r"expected a number, a length or a point, got \(nan, 0, 0\)"),
        (Sphere((0, 0, 0), "1 s"), "radius is in s"),
        (vm.regions.Region(), "does not tell where rays are inside"),
        (" | ".join(f"sphere(({x / 10}, 0, 0), 0.01)" for x in range(9)), "8 stretches at most"),
    ],
)
def test_what_is_no_region_is_refused(given, message):
    grid = vm.CartesianGrid.uniform(4, (-1, 1), unit="pc")
    with pytest.raises(vm.VoluminousError, match=message):
        vm.render(noise(grid), MEDIUM, ORTHOGRAPHIC, clip=given)


def test_bounds_are_of_whole_rays():
    with pytest.raises(vm.InputError, match="leave out clip=, or bounds=True"):
        vm.render(noise(CUBE), MEDIUM, ORTHOGRAPHIC, clip=BOX, bounds=True)


def test_lengths_have_units():
    grid = vm.CartesianGrid.uniform(4, (-2, 2), unit="pc")
    volume, camera = noise(grid), vm.Orthographic(40, 25, width=2, resolution=4)
    texts = "sphere((0.1 pc, 0 pc, 0 pc), 1 pc) & halfspace((0 pc, 0 pc, 0 pc), (0, 0, 1))"
    km = Sphere(np.array([0.1, 0, 0]) * u.pc.to("km") * u.km, "1 pc") & HalfSpace(
        ("0 m",) * 3, (0, 0, 2)
    )
    plain = Sphere((0.1, 0, 0), 1) & HalfSpace((0, 0, 0), (0, 0, 1))
    first, *others = (drawn(volume, c, camera, **FIRST)[0] for c in (plain, texts, km, str(km)))
    for other in others:
        np.testing.assert_allclose(other, first, rtol=1e-9)


def test_cropped_files_are_read_in_part(tmp_path):
    volume = vm.Volume(vm.CartesianGrid.uniform((8, 6, 4), (-1, 1), unit="pc"))
    volume["a"] = np.random.default_rng(0).uniform(0, 1, (8, 6, 4)).astype(np.float32) * u.g
    volume.save(tmp_path / "v.zarr")
    whole = open_lazily(tmp_path / "v.zarr")
    part = whole.crop(x=("-0.3 pc", 0.2 * u.pc), z=(None, 0))
    assert part.waiting == ("a",) == whole.waiting
    np.testing.assert_array_equal(part["a"], volume["a"][2:5, :, :2])
    assert whole.waiting == ("a",)
    kept = volume.crop(y=(0, 1))
    assert not np.may_share_memory(kept.array("a"), volume.array("a"))
    assert kept["a"].unit == u.g
    for wrong, message in (((1, 0), "in this order"), ((2, 3), "has no cells"), (3, "must be")):
        with pytest.raises(vm.InputError, match=message):
            volume.crop(x=wrong)
    with pytest.raises(vm.InputError, match="crop drops cells of Cartesian grids"):
        vm.Volume(GRIDS["octree"]).crop(x=(0, 1))


def test_scenes_hold_a_clip_as_a_text(tmp_path):
    tables = {
        "volume": {"model": "sphere", "resolution": 8},
        "medium": [{"type": "coefficients", "emissivity": "inside", "extinction": "inside"}],
        "camera": {"resolution": 6},
        "render": {"scheme": "first-order", "clip": HalfSpace((0, 0, "0.1"), (1, 0, 0)) & ~BOX},
    }
    scene = vm.Scene(tables)
    scene.save(tmp_path / "cut.toml")
    again = vm.Scene.load(tmp_path / "cut.toml")
    assert again.render_options["clip"] == str(tables["render"]["clip"])
    image = again.render()
    np.testing.assert_array_equal(image.intensity, scene.render().intensity)
    whole = scene.replaced({"render.clip": "~sphere((0, 0, 0), 9)"})
    with pytest.warns(UserWarning, match="shows nothing"):
        assert not whole.render().intensity.any()
    assert scene.render(clip=Sphere((0, 0, 0), 0.5)).provenance["scene"]["render"]["clip"] == (
        "sphere((0, 0, 0), 0.5)"
    )
    with pytest.raises(vm.VoluminousError, match=r"\[render\].*did you mean 'box'"):
        scene.replaced({"render.clip": "bx((0, 0, 0), (1, 1, 1))"})


def test_a_clip_may_move_through_a_film(tmp_path):
    volume, camera = noise(CUBE), ORTHOGRAPHIC.replace(resolution=4)
    clips = [HalfSpace((x, 0, 0), (1, 0, 0)) for x in (-1, 0, 1)]

    def made(clip):
        paths = vm.movie(volume, MEDIUM, camera, tmp_path / "cut.npz", clip=clip, **FIRST)
        return paths, [path.stat().st_mtime_ns for path in paths]

    paths, first = made(clips)
    for path, clip in zip(paths, clips, strict=True):
        expected = vm.render(volume, MEDIUM, camera, clip=clip, **FIRST).intensity
        np.testing.assert_array_equal(vm.Image.load(path).intensity, expected)
    assert made(clips)[1] == first
    changed = made([clips[0], clips[2], clips[2]])[1]
    assert [a == b for a, b in zip(changed, first, strict=True)] == [True, False, True]
    with pytest.raises(vm.InputError, match="2 cameras, 3 clips"):
        vm.movie(volume, MEDIUM, [camera] * 2, tmp_path / "cut.npz", clip=clips)
