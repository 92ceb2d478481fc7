"""Particles on grids: what they carry is conserved, and lies where closed forms say."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from voluminous.particles import KERNELS
from voluminous.particles.inputs import smoothing_lengths
from voluminous.particles.octree import Base, Refinement, octree_around
from voluminous.particles.smoothed import Overlaps, nodes_of

BOX = ((0, 1), (0, 1), (0, 1))


def total(volume, name=None):
    """The sum over cells of mass, or of mass times a field."""
    amount = volume.array("density") * volume.grid.cell_volumes
    return float(np.sum(amount if name is None else amount * volume.array(name)))


def cloud(count, seed=1):
    """A clustered cloud: positions, masses, smoothing lengths, velocities."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(count, 3)) * rng.choice([0.1, 0.5, 2.0], (count, 1))
    radius = np.linalg.norm(positions, axis=1)
    h = (0.05 + 0.3 * radius) * (300 / count) ** (1 / 3)
    return positions, rng.uniform(0.5, 2, count), h, rng.normal(size=(count, 3))


def lattice(n):
    """The middles of n³ equal cubes in the unit cube."""
    ticks = (np.arange(n) + 0.5) / n
    return np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)


def kernel_value(name, r, support):
    """The kernels as their authors write them (Price 2012; Dehnen & Aly 2012), in r and H."""
    u_ = np.minimum(r / support, 1.0)
    if name.startswith("wendland"):
        power, poly, norm = {
            "wendland-c2": (4, 1 + 4 * u_, 21 / 2),
            "wendland-c4": (6, 1 + 6 * u_ + 35 / 3 * u_**2, 495 / 32),
            "wendland-c6": (8, 1 + 8 * u_ + 25 * u_**2 + 32 * u_**3, 1365 / 64),
        }[name]
        return norm / np.pi / support**3 * (1 - u_) ** power * poly
    widest, power, coefficients, norm = {
        "cubic": (2, 3, (1, -4), 1 / (4 * np.pi)),
        "quartic": (2.5, 4, (1, -5, 10), 1 / (20 * np.pi)),
        "quintic": (3, 5, (1, -6, 15), 1 / (120 * np.pi)),
    }[name]
    terms = (
        c * np.maximum(widest - k - widest * u_, 0) ** power for k, c in enumerate(coefficients)
    )
    return norm * (widest / support) ** 3 * sum(terms)


@pytest.mark.parametrize("name", KERNELS)
def test_kernels_are_those_of_the_papers_and_integrate_to_one(name):
    r = np.linspace(0, 1, 20001)
    kernel = KERNELS[name]
    own = kernel.norm * kernel.shape(r, lambda x: np.maximum(x, 0))
    np.testing.assert_allclose(own, kernel_value(name, r, 1.0), atol=1e-12)
    # The trapezoidal rule, of second order: 1e-8 for this step.
    assert np.trapezoid(4 * np.pi * r * r * own, r) == pytest.approx(1, abs=1e-6)
    assert own[-1] == pytest.approx(0, abs=1e-12)
    assert (np.diff(own) <= 1e-12).all()


CASES = {
    "smoothed": lambda h: {"smoothing_length": h},
    "quintic": lambda h: {"smoothing_length": h, "kernel": "quintic"},
    "mesh": lambda h: {"volume": h**3},
    "density": lambda h: {"density": h**-3},
    "neither": lambda h: {},
    "box": lambda h: {"smoothing_length": h, "bounds": (-20, 20)},
    "periodic": lambda h: {"smoothing_length": h, "bounds": (-1, 1), "periodic": True},
    "periodic mesh": lambda h: {"volume": h**3, "bounds": (-1, 1), "periodic": True},
    "periodic, neither": lambda h: {"bounds": (-1, 1), "periodic": True},
}


@pytest.mark.parametrize("case", CASES)
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**16), count=st.integers(1, 60))
def test_mass_and_momentum_are_conserved(case, seed, count):
    positions, masses, h, velocity = cloud(count, seed)
    fields = {"v": velocity, "a": np.linspace(3, 5, count)}
    volume = vm.Volume.from_particles(positions, masses, fields=fields, **CASES[case](h))
    # Sums in double precision: rounding only, of a few hundred terms.
    assert total(volume) == pytest.approx(masses.sum(), rel=1e-12)
    scale = np.sum(masses[:, None] * np.abs(velocity), axis=0)
    for k, axis in enumerate("xyz"):
        difference = total(volume, f"v_{axis}") - np.sum(masses * velocity[:, k])
        assert abs(difference) <= 1e-12 * scale[k]
    mean, massive = volume.array("a"), volume.array("density") > 0
    assert (volume.array("density") >= 0).all()
    assert mean[massive].min() >= 3 - 1e-9
    assert mean[massive].max() <= 5 + 1e-9
    assert (mean[~massive] == 0).all()


def test_the_same_particles_give_the_same_bits_in_any_run_and_nearly_so_in_any_order():
    positions, masses, h, _ = cloud(500)
    one = vm.Volume.from_particles(positions, masses, smoothing_length=h)
    two = vm.Volume.from_particles(positions, masses, smoothing_length=h)
    assert one.array("density").tobytes() == two.array("density").tobytes()
    order = np.random.default_rng(3).permutation(500)
    other = vm.Volume.from_particles(positions[order], masses[order], smoothing_length=h[order])
    np.testing.assert_array_equal(other.grid.levels, one.grid.levels)
    np.testing.assert_allclose(other.array("density"), one.array("density"), rtol=1e-12)


@pytest.mark.parametrize("case", ["smoothed", "mesh", "neither"])
@pytest.mark.parametrize("power", [-250, 70, 250])
def test_lengths_and_masses_scale(case, power):
    positions, masses, h, _ = cloud(60)
    one = vm.Volume.from_particles(positions, masses, **CASES[case](h))
    scale = 2.0**power  # 1e-75 to 1e75; a power of two changes no digit
    other = vm.Volume.from_particles(scale * positions, 3 * masses, **CASES[case](scale * h))
    np.testing.assert_array_equal(other.grid.levels, one.grid.levels)
    # Weights are kept in single precision.
    expected = 3 * one.array("density")
    np.testing.assert_allclose(other.array("density") * scale**3, expected, rtol=2e-6)


# --- the octree -------------------------------------------------------------------------------


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**16), count=st.integers(1, 5), most=st.integers(0, 7))
def test_cells_are_split_where_the_rule_says_so_and_nowhere_else(seed, count, most):
    rng = np.random.default_rng(seed)
    points = 0.5 + 0.1 * rng.normal(size=(60, 3))
    finest, widest = np.full(60, 0.01), rng.uniform(0.02, 0.2, 60)
    base = Base.within(np.array(BOX, float))
    rule = Refinement(count, finest, widest, np.zeros(60), 1, most) if most else None
    if rule is None:
        return
    grid = octree_around(base, points, rule)
    leaf, width = grid.locate(points), 0.5 ** grid.levels.astype(float)
    inside = np.flatnonzero(leaf >= 0)
    deepest = grid.levels[leaf[inside]] == most
    assert grid.levels.min() >= 1
    assert ((width[leaf[inside]] <= widest[inside]) | deepest).all()
    number = np.bincount(leaf[inside], minlength=grid.size)
    assert ((number <= count) | (width <= 0.01) | (grid.levels == most)).all()
    _check_reasons(grid, points[inside], widest[inside], count)


def _check_reasons(grid, points, widest, count):
    """Every split node has too many particles, or is too wide for one of them."""
    nodes = nodes_of(grid)
    split = np.ones(nodes.size, bool)
    split[nodes.leaf] = False
    for low, width, level in zip(
        nodes.low[split], nodes.part[split], nodes.level[split], strict=True
    ):
        there = ((points >= low) & (points < low + width)).all(axis=1)
        many, wide = there.sum() > count, (widest[there] < width).any()
        assert many or wide or level < 1


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**16))
def test_overlaps_are_those_that_a_search_of_all_pairs_finds(seed):
    rng = np.random.default_rng(seed)
    points, radius = rng.random((30, 3)), rng.uniform(0.01, 0.3, 30)
    base = Base.within(np.array(BOX, float))
    grid = octree_around(base, points, Refinement(1, radius / 4))
    overlaps = Overlaps(nodes := nodes_of(grid), points, radius, KERNELS["cubic"])
    counts = overlaps.counts(0, 30)
    particle, node = overlaps.pairs(0, counts)
    low, high = grid.corners()
    for k in range(30):
        found = node[particle == k]
        assert len(found) == counts[k]
        away = np.maximum(np.maximum(low.T - points[k], points[k] - high.T), 0)
        expected = np.flatnonzero((away**2).sum(axis=1) < radius[k] ** 2)
        held = [c for n in found for c in _leaves_in(nodes, n)]
        assert len(held) == len(set(held))
        assert set(expected) <= set(held)
        coarse = nodes.part[found] <= radius[k] / 4
        assert (coarse | np.isin(found, nodes.leaf)).all()


def _leaves_in(nodes, node):
    return np.flatnonzero((nodes.leaf >= node) & (nodes.leaf < nodes.after[node]))


# --- kernels over cells -----------------------------------------------------------------------


@pytest.mark.parametrize("name", KERNELS)
def test_weights_are_the_integrals_of_kernels_over_cells(name):
    grid = vm.OctreeGrid(*3 * [np.linspace(0, 1, 5)])
    point, radius = np.array([[0.53, 0.41, 0.47]]), np.array([0.45])
    overlaps = Overlaps(nodes_of(grid), point, radius, KERNELS[name])
    pairs = overlaps.pairs(0, overlaps.counts(0, 1))
    weights = overlaps.weights(*pairs)
    low, high = grid.corners()
    fine = (np.arange(24) + 0.5) / 24
    offsets = np.stack(np.meshgrid(fine, fine, fine, indexing="ij"), axis=-1).reshape(-1, 3)
    for node, weight in zip(pairs[1], weights, strict=True):
        places = low[:, node] + offsets * (high - low)[:, node]
        r = np.linalg.norm(places - point, axis=1)
        expected = kernel_value(name, r, 0.45).mean() * 0.25**3
        # Midpoints an eighth of the support apart: for the narrowest kernel 4 % at its peak, 0.3.
        assert weight == pytest.approx(expected, abs=0.015)
    assert weights.sum() == pytest.approx(1, abs=0.01)


def test_a_broad_kernel_over_fine_cells_is_the_kernel_still():
    # Fine cells around many narrow particles without mass, under one broad one.
    rng = np.random.default_rng(5)
    narrow = 0.5 + 0.01 * rng.normal(size=(300, 3))
    positions = np.concatenate([[[0.5, 0.5, 0.5]], narrow])
    h = np.append(0.2, np.full(300, 0.002))
    masses = np.append(1.0, np.zeros(300))
    volume = vm.Volume.from_particles(positions, masses, smoothing_length=h, bounds=(0, 1))
    r = np.linalg.norm(volume.grid.cell_centers() - 0.5, axis=0)
    expected = kernel_value("cubic", r, 0.4)
    peak = kernel_value("cubic", 0.0, 0.4)
    size = volume.grid.cell_sizes()[0]
    fine = size < 0.01
    assert fine.sum() > 500
    # There it is taken at nodes of a quarter of the radius: 0.1 wide, h/2.
    np.testing.assert_allclose(volume.array("density")[fine], expected[fine], atol=0.12 * peak)


@pytest.mark.parametrize(
    ("h", "bounds", "level"),
    [(0.25, BOX, 3), (0.6, BOX, 2), (2.0, BOX, 2), (0.5, ((0, 0.5), (0, 1), (0, 4)), 1)],
)
def test_kernels_broader_than_a_periodic_box_come_back_into_it(h, bounds, level):
    point, size = np.array([0.2, 0.3, 0.6]), np.ptp(bounds, axis=1)
    box = {"bounds": bounds, "periodic": True, "min_level": level, "max_level": level}
    volume = vm.Volume.from_particles([point], 1.0, smoothing_length=h, **box)
    most = np.ceil(2 * h / size).astype(int)
    steps = np.meshgrid(*[np.arange(-n, n + 1) for n in most], indexing="ij")
    shifts = np.stack(steps, axis=-1).reshape(-1, 3) * size
    # The mean over each cell, by 4³ midpoints.
    offsets = (lattice(4) - 0.5)[:, None] * volume.grid.cell_sizes().T
    places = volume.grid.cell_centers().T + offsets - point
    expected = np.zeros(places.shape[1])
    for shift in shifts:
        r = np.linalg.norm(places - shift, axis=-1)
        expected += kernel_value("cubic", r, 2 * h).mean(axis=0)
    # Midpoints are about a quarter of the radius apart: some percent, of each image's peak too.
    atol = 0.05 * kernel_value("cubic", 0.0, 2 * h)
    np.testing.assert_allclose(volume.array("density"), expected, rtol=0.05, atol=atol)


def test_far_too_many_images_are_refused():
    positions = np.random.default_rng(1).random((1000, 3)) * (1e-3, 1e-3, 1)
    bounds = ((0, 1e-3), (0, 1e-3), (0, 1))
    with pytest.raises(
        vm.errors.MemoryNeededError, match=r"images of particles .*check their unit"
    ):
        vm.Volume.from_particles(
            positions, 1.0, smoothing_length=10.0, bounds=bounds, periodic=True
        )


def test_a_periodic_box_has_no_walls():
    positions, masses, h, _ = cloud(200)
    h = np.minimum(h, 1.0)  # nodes of broader kernels are wider than the step is long
    box, step = {"bounds": (-1, 1), "periodic": True}, np.array([0.5, 1.0, -2.5])
    one = vm.Volume.from_particles(positions, masses, smoothing_length=h, **box)
    moved = vm.Volume.from_particles(positions + step, masses, smoothing_length=h, **box)
    places = (one.grid.cell_centers().T + step + 1) % 2 - 1
    there = moved.grid.locate(places)
    np.testing.assert_array_equal(moved.grid.levels[there], one.grid.levels)
    np.testing.assert_allclose(moved.array("density")[there], one.array("density"), rtol=1e-5)


def stretched(n, sigma):
    """A lattice in a ball, stretched radially to a Gaussian: no noise of random numbers."""
    from scipy.special import gammaincinv

    points = lattice(n) * 2 - 1
    r = np.linalg.norm(points, axis=1)
    points, r = points[r < 1], r[r < 1]
    stretched = sigma * np.sqrt(2 * gammaincinv(1.5, r**3))
    return points * (stretched / r)[:, None], stretched


@pytest.mark.parametrize("kind", ["smoothed", "mesh"])
def test_the_density_converges_to_a_gaussian(kind):
    pytest.importorskip("scipy")
    errors = []
    for n in (12, 24):
        points, r = stretched(n, 1.0)
        exact = np.exp(-0.5 * r**2) / (2 * np.pi) ** 1.5
        own = (1 / len(points) / exact) ** (1 / 3)
        options = {"smoothing_length": 1.2 * own} if kind == "smoothed" else {"volume": own**3}
        volume = vm.Volume.from_particles(points, 1 / len(points), cell_width=0.6, **options)
        x = volume.grid.cell_centers()
        expected = np.exp(-0.5 * (x**2).sum(axis=0)) / (2 * np.pi) ** 1.5
        difference = np.abs(volume.array("density") - expected) * volume.grid.cell_volumes
        errors.append(float(difference.sum()))
    # Kernels smooth, which is of second order but for the rim (2.8 here, not 4); a mesh is constant
    # in each cell: of first order.
    assert errors[1] < errors[0] / (2.5 if kind == "smoothed" else 1.6)
    assert errors[1] < (0.05 if kind == "smoothed" else 0.12)


# --- meshes -----------------------------------------------------------------------------------


def test_a_mesh_of_cubes_is_that_mesh():
    rng = np.random.default_rng(4)
    density = rng.uniform(1, 2, 512)
    volume = vm.Volume.from_particles(lattice(8), density / 512, density=density, bounds=(0, 1))
    there = volume.grid.locate(lattice(8) + 0.01)
    np.testing.assert_allclose(volume.array("density")[there], density, rtol=1e-12)


# --- crops ------------------------------------------------------------------------------------


def test_a_crop_holds_the_parts_of_kernels_that_are_inside():
    positions = lattice(10) + 0.01 * np.random.default_rng(1).normal(size=(1000, 3))
    whole = vm.Volume.from_particles(positions, 1e-3, smoothing_length=0.12, bounds=(0, 1))
    part = vm.Volume.from_particles(positions, 1e-3, smoothing_length=0.12, bounds=(0.25, 0.75))
    places = part.grid.cell_centers().T
    there = whole.grid.locate(places)
    same = whole.grid.cell_sizes()[0][there] == part.grid.cell_sizes()[0]
    assert same.mean() > 0.8  # bounds are walls of the whole's cells
    # Weights of what reaches over the walls are normalised otherwise: by the integrals' error.
    expected = whole.array("density")[there]
    np.testing.assert_allclose(part.array("density")[same], expected[same], rtol=0.02)
    assert total(part) == pytest.approx(0.125, rel=0.02)


def test_a_crop_holds_the_parts_of_mesh_cells_that_are_inside():
    density = np.random.default_rng(4).uniform(1, 2, 512)
    bounds = ((0.25, 0.75), (0.0625, 0.5625), (-0.25, 0.75))  # through cells, and outside
    volume = vm.Volume.from_particles(lattice(8), density / 512, density=density, bounds=bounds)
    x = volume.grid.cell_centers().T
    number = np.ravel_multi_index(np.clip((x * 8).astype(int), 0, 7).T, (8, 8, 8))
    # Places outside of the mesh belong to the outermost cells.
    inside = (np.abs(volume.grid.cell_sizes()[2]) < 0.1) & (x[:, 2] > 0)
    np.testing.assert_allclose(volume.array("density")[inside], density[number[inside]], rtol=1e-9)


# --- particles without sizes ------------------------------------------------------------------


def test_smoothing_lengths_of_a_lattice_are_1_2_spacings():
    h = smoothing_lengths(Base.within(np.array(BOX, float), True), lattice(16))
    # Counts in cells differ by the kernel's own error only, on a lattice.
    np.testing.assert_allclose(h, 1.2 / 16, rtol=0.03)


def test_smoothing_lengths_follow_the_density():
    rng = np.random.default_rng(2)
    radius = (rng.random(4000) ** (-2 / 3) - 1) ** -0.5  # a Plummer sphere (Aarseth et al. 1974)
    direction = rng.normal(size=(4000, 3))
    points = radius[:, None] * direction / np.linalg.norm(direction, axis=1)[:, None]
    density = 4000 * 3 / (4 * np.pi) * (1 + radius**2) ** -2.5
    ratio = smoothing_lengths(None, points) / (1.2 * density ** (-1 / 3))
    # Cells of 2 to 16 particles that are smoothed once: half of the density is noise where few are,
    # a sixth of the length.
    assert np.median(ratio) == pytest.approx(1, abs=0.05)
    assert np.std(ratio[radius < 3]) < 0.17


# --- units and errors -------------------------------------------------------------------------


def test_units_go_through():
    positions, masses, h, velocity = cloud(30)
    volume = vm.Volume.from_particles(
        positions * u.kpc,
        masses * u.solMass,
        smoothing_length=(h * u.kpc).to(u.pc),
        fields={"velocity": velocity * u.km / u.s, "rank": np.arange(30)},
        bounds=(-20000, 20000) * u.pc,
    )
    assert volume.unit == u.kpc
    assert volume.units["density"] == "solMass / kpc3"
    assert volume.units["velocity_z"] == "km / s"
    assert volume.units["rank"] == ""
    np.testing.assert_allclose(volume.grid.bounds, [[-20, 20]] * 3)
    plain = vm.Volume.from_particles(
        positions, masses, smoothing_length=h, bounds=(-20, 20), unit="kpc"
    )
    np.testing.assert_allclose(plain.array("density"), volume.array("density"), rtol=1e-5)
    assert plain.units["density"] == "1 / kpc3"
    assert vm.Volume.from_particles(positions, masses).units["density"] == ""


@pytest.mark.parametrize("positions", [[[0.0, 0, 0]], [[1.0, 2, 3]] * 20, [[0.0, 0, 0], [1, 0, 0]]])
@pytest.mark.parametrize("case", ["smoothed", "mesh", "neither"])
def test_degenerate_sets_of_particles(positions, case):
    count = len(positions)
    volume = vm.Volume.from_particles(positions, np.ones(count), **CASES[case](np.ones(count)))
    assert total(volume) == pytest.approx(count, rel=1e-12)


# A masked value is none: the coordinate of a particle, or one of three masses.
MASKED = np.ma.masked_equal([[1.0, 2, 9], [3, 4, 5], [6, 7, 9]], 7)
GOOD = np.array([[0.0, 0, 0], [1, 1, 1]])


ONE = (GOOD, 1.0)
UNKNOWN, UNITS = vm.errors.UnknownNameError, vm.UnitsError
MISTAKES = [
    ((np.zeros((0, 3)), 1.0), {}, "shape"),
    ((np.zeros(3), 1.0), {}, r"\(n, 3\)"),
    (([[0, 0, np.nan]], 1.0), {}, "positions must be finite; particle 0"),
    ((MASKED, 1.0), {}, "positions must be finite; particle 2 is not. Leave"),
    ((np.eye(3), MASKED[2]), {}, "masses must be finite; particle 1 is not"),
    ((np.eye(3), 1.0), {"smoothing_length": MASKED[2]}, "_length must be finite; particle 1"),
    ((GOOD, [1.0, -1]), {}, "masses must not be negative; that of particle 1"),
    ((GOOD, [1.0] * 3), {}, "one number per particle"),
    ((GOOD, 0.0), {"density": 1.0}, "positive masses"),
    ((GOOD * 1j, 1.0), {}, "positions must be real"),
    ((GOOD, np.array([1j, 2])), {}, "masses must be real"),
    (ONE, {"smoothing_length": 0.0}, "positive"),
    (ONE, {"smoothing_length": 1.0, "volume": 1.0}, "one of"),
    (ONE, {"volume": 1.0, "density": 1.0}, "one of"),
    (ONE, {"periodic": True}, "bounds"),
    (ONE, {"bounds": (5, 6)}, "no particle"),
    (ONE, {"max_particles": 0}, "max_particles"),
    (ONE, {"max_particles": None}, "max_particles must be a whole"),
    (ONE, {"max_level": 3.5}, "whole numbers"),
    (ONE, {"max_level": 21}, "max_level"),
    (ONE, {"cell_width": "1"}, "cell_width"),
    (ONE, {"cell_width": np.inf}, "cell_width"),
    (ONE, {"cell_width": -1}, "cell_width"),
    (ONE, {"empty": None, "fields": {"a": [1.0, 2]}}, "empty must be"),
    (ONE, {"bounds": (0, 1), "periodic": (1, 0, 1)}, "some axes"),
    (ONE, {"fields": [1.0, 2]}, "mapping of names to arrays"),
    (ONE, {"fields": {"a": [[1.0], [1, 2]]}}, "array of numbers"),
    (ONE, {"fields": {"v": np.ones((2, 3)), "v_x": [1.0, 2]}}, "two fields are called 'v_x'"),
    (ONE, {"fields": {"a": [1.0]}}, "one value or one vector"),
    (ONE, {"fields": {"density": [1.0, 2]}}, "made of masses"),
    (ONE, {"fields": {"a": ["b", "c"]}}, "real numbers"),
    (ONE, {"kernel": "cubik"}, "cubic", UNKNOWN),
    (ONE, {"kernel": ["cubic"]}, "cubic", UNKNOWN),
    (ONE, {"min_level": 19}, "max_level", vm.errors.MemoryNeededError),
    (ONE, {"bounds": "all"}, "bounds must be", UNITS),
    (ONE, {"unit": "kg"}, "unit of mass", UNITS),
    ((GOOD * u.pc, 1.0), {"smoothing_length": 1 * u.g}, "smoothing_length", UNITS),
    (ONE, {"bounds": (0, 1) * u.pc}, "bounds", UNITS),
]


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake[2])
def test_errors_say_what_was_expected(mistake):
    arguments, options, words, *error = mistake
    with pytest.raises(error[0] if error else vm.InputError, match=words):
        vm.Volume.from_particles(*arguments, **options)


@pytest.mark.parametrize("case", ["smoothed", "mesh"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_missing_value_counts_only_where_its_particle_is(case, bad):
    positions, masses, h, _ = cloud(100)
    carried, there = np.ones(100), np.zeros(100)
    carried[7], there[7] = bad, 1.0
    volume = vm.Volume.from_particles(
        positions, masses, fields={"a": carried, "there": there}, **CASES[case](h)
    )
    found, share = volume.array("a"), volume.array("there")
    massive = volume.array("density") > 0
    np.testing.assert_array_equal(np.isfinite(found[massive]), share[massive] == 0)
    # A particle without mass is nowhere.
    masses[7] = 0.0 if case == "smoothed" else masses[7]
    nowhere = vm.Volume.from_particles(positions, masses, fields={"a": carried}, **CASES[case](h))
    assert np.isfinite(nowhere.array("a")).all() == (case == "smoothed")
