"""Models that are written for RADMC-3D: read again they have the same bits."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from astropy import units as u
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from radmc3d_models import LAYERS, same
from voluminous.radmc3d import write

PI = np.pi
CUBES = [np.arange(3.0), np.arange(4.0), np.arange(3.0)]
SIZES = st.integers(1, 4)


def edges(rng, cells, low=-2.0, high=3.0):
    return np.sort(rng.uniform(low, high, cells + 1))


def cartesian(rng, n):
    return vm.CartesianGrid(*(edges(rng, k) for k in n), unit="cm")


def octree(rng, n):
    grid = vm.OctreeGrid(*(edges(rng, k) for k in n), unit="cm")
    for _ in range(rng.integers(0, 4)):
        grid = grid.refine(rng.random(grid.size) < 0.2)
    return grid


def spherical(rng, n, refined=False):
    theta = edges(rng, n[1], 0.1, 3.0) if n[1] > 1 else np.array([0.0, PI])
    mirror = bool(rng.random() < 0.5) and n[1] > 1
    if mirror:
        theta = np.append(theta[theta < 1.5], PI / 2)
    elif n[1] > 1:
        theta = np.sort(np.append(theta, PI / 2))
        theta = np.append(theta, 3.1) if theta[-1] == PI / 2 else theta
    theta = theta if len(theta) > 1 else np.array([0.3, PI / 2])
    phi = edges(rng, n[2], 0.0, 6.2) if n[2] > 1 and n[1] > 1 else np.array([0.0, 2 * PI])
    r = edges(rng, n[0], 1.0, 9.0)
    plain = vm.SphericalGrid(r, theta, phi, mirror=mirror, unit="cm")
    closes = len(phi) == 2 and phi[1] == 2 * PI
    if not refined or (np.diff(phi).max() > PI and not closes):
        return plain
    closed = sum(len(e) == 2 and e[1] - e[0] == whole for e, whole in ((theta, PI), (phi, 2 * PI)))
    flags = np.zeros(plain.size, int).tolist()
    at = int(rng.integers(len(flags)))
    flags[at : at + 1] = [1] + [0] * (1 << (3 - int(closed)))
    return vm.SphericalGrid(r, theta, phi, mirror=mirror, refined=flags, unit="cm")


def layered(rng, n):
    walls = [np.linspace(-1, 1, 2 * k + 1) for k in n]
    shape, rows = np.array([2 * k for k in n]), []
    low = rng.integers(0, shape)
    size = rng.integers(1, shape - low + 1)
    rows.append([0, *(low + 1), *size])
    if rng.random() < 0.7:
        inner = rng.integers(0, 2 * size)
        rows.append([1, *(inner + 1), *rng.integers(1, 2 * size - inner + 1)])
    return vm.PatchGrid.from_layers(*walls, np.array(rows), unit="cm")


GRIDS = {
    "cartesian": cartesian,
    "octree": octree,
    "spherical": spherical,
    "refined spherical": lambda rng, n: spherical(rng, n, refined=True),
    "layers": layered,
}


def quietly(work, *arguments, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # cells that are no cubes
        return work(*arguments, **options)


def same_grid(found, expected):
    assert found.describe() == expected.describe()
    centers = [g.native_centers() for g in (found, expected)]
    same(*centers)
    same(*(np.asarray(g.levels) for g in (found, expected)))


@settings(deadline=None, max_examples=120)
@given(
    kind=st.sampled_from(sorted(GRIDS)),
    n=st.tuples(SIZES, SIZES, SIZES),
    seed=st.integers(0, 2**31),
    binary=st.booleans(),
)
def test_a_model_comes_back(tmp_path_factory, kind, n, seed, binary):
    rng = np.random.default_rng(seed)
    grid = GRIDS[kind](rng, n)
    names = ["gas_density", "dust_temperature", "numberdens_co"]
    names += [f"dust_density_{k}" for k in (1, 2)]
    names += [f"gas_velocity_{axis}" for axis in grid.coordinates]
    volume = vm.Volume(grid)
    for name in names:
        values = rng.choice([1.0, -1.0], grid.shape) * 10 ** rng.uniform(-300, 300, grid.shape)
        values[rng.random(grid.shape) < 0.1] = rng.choice([np.nan, np.inf, 0.0, 5e-324, -0.0])
        volume[name] = values
    directory = tmp_path_factory.mktemp("model")
    quietly(write, volume, directory, binary=binary)
    again = vm.open(directory)
    assert set(again.fields) == set(names)
    same_grid(again.grid, grid)
    for name in names:
        same(again.array(name), volume.array(name))


def test_units_are_radmc3ds(tmp_path):
    grid = vm.CartesianGrid(*CUBES, unit="pc")
    volume = vm.Volume(grid, rho=np.ones(grid.shape) * u.kg / u.m**3, v_x=np.ones(grid.shape))
    volume["T"] = np.full(grid.shape, 2.0) * u.kK
    volume["v_y"] = volume["v_z"] = np.full(grid.shape, 3.0) * u.km / u.s
    fields = {"gas_density": "2 * rho", "gas_temperature": "T", "gas_velocity": "v"}
    fields |= {"microturbulence": 1 * u.km / u.s, "tracer": "x", "dust_density": ["rho", 0.5]}
    write(volume, tmp_path / "m", fields)
    again = vm.open(tmp_path / "m")
    found = {name: float(again.array(name).flat[0]) for name in again.fields}
    assert found["gas_density"] == pytest.approx(2e-3, rel=1e-15)
    assert found["gas_temperature"] == 2000
    assert found["gas_velocity_x"] == 1  # no unit: taken to be in cm / s
    assert found["gas_velocity_y"] == pytest.approx(3e5, rel=1e-15)
    assert found["microturbulence"] == 1e5
    assert (found["dust_density_1"], found["dust_density_2"]) == (pytest.approx(1e-3), 0.5)
    assert found["tracer"] == 0.5
    np.testing.assert_allclose(again.grid.edges[0], CUBES[0] * (1 * u.pc).to_value("cm"))
    volume.set_unit("T", "km")
    with pytest.raises(vm.UnitsError, match="gas_temperature must be in K, but 'T' is in km"):
        write(volume, tmp_path / "n", fields)
    assert not (tmp_path / "n").exists()


def test_names_tell_files_and_others_are_left_out(tmp_path):
    grid = vm.CartesianGrid(*CUBES, unit="cm")
    names = ("density", "temperature", "velocity_x", "velocity_y", "velocity_z", "entropy")
    volume = vm.Volume(grid, {name: np.ones(grid.shape) for name in names})
    with pytest.warns(UserWarning, match="left out: entropy; .*fields="):
        written = write(volume, tmp_path / "m")
    stems = ["amr_grid", "gas_density", "gas_temperature", "gas_velocity"]
    assert [path.name for path in written] == [f"{stem}.inp" for stem in stems]
    with pytest.raises(vm.InputError, match="none of the fields entropy is called like"):
        write(vm.Volume(grid, entropy=np.ones(grid.shape)), tmp_path / "n")


def test_nothing_is_replaced_unless_told(tmp_path):
    grid = vm.CartesianGrid(*CUBES, unit="cm")
    volume = vm.Volume(grid, density=np.ones(grid.shape), temperature=np.ones(grid.shape))
    fields = {"gas_density": "density"}
    assert len(write(volume, tmp_path / "m", fields)) == 2
    with pytest.raises(vm.InputError, match=r"m has gas_density.inp already; give overwrite=True"):
        write(volume, tmp_path / "m", fields, binary=True)
    # The same grid is left alone, and more fields can be put beside.
    assert len(write(volume, tmp_path / "m", {"gas_temperature": "temperature"})) == 1
    coarse = vm.Volume(vm.CartesianGrid(*[[0, 1, 2]] * 3, unit="cm"), density=np.ones((2, 2, 2)))
    with pytest.raises(vm.InputError, match=r"m has gas_density.inp, amr_grid.inp|amr_grid.inp"):
        write(coarse, tmp_path / "m")
    write(coarse, tmp_path / "m", binary=True, overwrite=True)
    # Of no file there are two forms: RADMC-3D would stop.
    left = sorted(path.name for path in (tmp_path / "m").iterdir())
    assert left == ["amr_grid.binp", "gas_density.binp", "gas_temperature.inp"]


def test_patches_become_layers_or_an_octree(tmp_path):
    rng = np.random.default_rng(3)
    even = [np.linspace(-1, 1, n + 1) for n in (4, 6, 8)]
    layers = vm.PatchGrid.from_layers(*even, LAYERS, unit="cm")
    # A step of four, and a patch across two others: no layers.
    low = [[0, 0, 0], [1, 1, 1], [2, 1, 1], [1, 1, 1]]
    high = [[4, 4, 4], [2, 2, 2], [3, 2, 2], [3, 1.5, 1.5]]
    steps = vm.PatchGrid(low, high, [[4, 4, 4], [2, 2, 2], [2, 2, 2], [8, 2, 2]], unit="cm")
    for grid, kind in ((layers, vm.PatchGrid), (steps, vm.OctreeGrid)):
        volume = vm.Volume(grid, gas_density=rng.random(grid.size))
        quietly(write, volume, tmp_path / kind.__name__)
        again = vm.open(tmp_path / kind.__name__)
        assert isinstance(again.grid, kind)
        assert again.grid.size == grid.size
        there = again.grid.locate(grid.cell_centers().T)
        same(again.array("gas_density")[there], volume.array("gas_density"))


@pytest.mark.parametrize(
    ("grid", "told"),
    [
        (vm.CylindricalGrid([1, 2], [0, 1], [0, 1], unit="cm"), "Cartesian and spherical"),
        (vm.SphericalGrid([1, 2], [0.5, PI / 2], unit="cm"), "mirror=True"),
        (vm.SphericalGrid([1, 2], [0, 1, 2], [-1, 0, 1], unit="cm"), "phi must lie between"),
        (vm.PatchGrid([[0, 0, 0], [2, 0, 0]], [[1, 1, 1], [3, 1, 1]], [[2, 2, 2]] * 2), "holes"),
        (
            vm.PatchGrid([[0, 0, 0]] * 2, [[2, 2, 2], [1, 1, 1]], [[2, 2, 2], [3, 3, 3]]),
            "halves cells",
        ),
    ],
)
def test_grids_that_radmc3d_has_not(tmp_path, grid, told):
    with pytest.raises(vm.InputError, match=told):
        write(vm.Volume(grid, density=np.ones(grid.shape)), tmp_path / "m")
    assert not (tmp_path / "m").exists()


def test_radmc3d_would_refuse(tmp_path):
    grids = [
        (vm.CartesianGrid([0, 1, 3], [0, 1], [0, 1], unit="cm"), "cubes"),
        (vm.SphericalGrid([0, 1], [0, PI / 2, PI], unit="cm"), "begin at 0"),
        (vm.SphericalGrid([1, 2], [0, 1, PI], unit="cm"), "wall at the midplane"),
    ]
    for k, (grid, told) in enumerate(grids):
        with pytest.warns(UserWarning, match=f"RADMC-3D will refuse.*{told}"):
            write(vm.Volume(grid, density=np.ones(grid.shape)), tmp_path / str(k))


@pytest.mark.parametrize(
    ("fields", "error", "told"),
    [
        ({}, vm.InputError, "a table"),
        ("density", vm.InputError, "a table"),
        ({"../x": "density"}, vm.InputError, "cannot be a file's name"),
        ({"gas_density": "densty"}, vm.errors.UnknownNameError, "did you mean 'density'"),
        ({"gas_velocity": ["density"]}, vm.InputError, "takes 3 fields, got 1"),
        ({"gas_density": ["density"] * 2}, vm.InputError, "takes 1 field, got 2"),
        ({"levelpop_co": "density"}, vm.InputError, "own results"),
        ({"gas_density": None}, vm.InputError, "must be a field"),
    ],
)
def test_fields_that_cannot_be_written(tmp_path, fields, error, told):
    grid = vm.CartesianGrid(*CUBES, unit="cm")
    with pytest.raises(error, match=told):
        write(vm.Volume(grid, density=np.ones(grid.shape)), tmp_path / "m", fields)
    assert not (tmp_path / "m").exists()
