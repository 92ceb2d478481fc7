"""Snapshots of particles: Gadget and its kin, and Phantom."""

from __future__ import annotations

import struct

import h5py
import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from contracts.reader import ReaderContract
from reference import data_directory
from voluminous.io import find_reader

KPC, MSUN10, KMS = 3.085678e21, 1.989e43, 1e5
RNG = np.random.default_rng(7)
COUNT = 9
POSITIONS = RNG.uniform(1, 9, (COUNT, 3))
VELOCITIES = RNG.normal(size=(COUNT, 3)) * 100
MASSES = RNG.uniform(1, 2, COUNT)
LENGTHS = RNG.uniform(1, 2, COUNT).astype("f4").astype(float)  # as Phantom keeps them
UNITS = {"UnitLength_in_cm": KPC, "UnitMass_in_g": MSUN10, "UnitVelocity_in_cm_per_s": KMS}


def data(**more):
    """Data sets of particles; None leaves one out."""
    found = {
        "Coordinates": POSITIONS,
        "Velocities": VELOCITIES.astype("f4"),
        "Masses": MASSES,
        "ParticleIDs": np.arange(COUNT),
        "InternalEnergy": np.full(COUNT, 250.0),
        **more,
    }
    return {name: values for name, values in found.items() if values is not None}


def gadget(path, sets, kind=0, *, files=1, header=UNITS, attributes=None):
    """Write a snapshot like Gadget's."""
    count = len(sets["Coordinates"])
    with h5py.File(path, "w") as file:
        head = file.create_group("Header")
        this = np.zeros(6, int)
        this[kind] = count
        head.attrs.update(NumPart_ThisFile=this, NumFilesPerSnapshot=files, Time=0.5, BoxSize=10.0)
        head.attrs.update(MassTable=np.zeros(6), Redshift=0.0)
        head.attrs.update(header)
        for name, values in sets.items():
            file[f"PartType{kind}/{name}"] = values
            file[f"PartType{kind}/{name}"].attrs.update((attributes or {}).get(name, {}))
    return path


def smoothed():
    return data(SmoothingLength=2 * LENGTHS)


def total(volume, name=None):
    """Mass, or mass times a field, as a Quantity."""
    length = volume.unit or u.dimensionless_unscaled
    amount = volume["density"] * volume.grid.cell_volumes * length**3
    return amount.sum() if name is None else (amount * volume[name]).sum()


class TestGadget(ReaderContract):
    @pytest.fixture
    def sample(self):
        return lambda directory: gadget(directory / "snapshot_000.hdf5", smoothed())


def same(one, other):
    """The same cells and the same values, to the rounding of single-precision weights."""
    np.testing.assert_array_equal(one.grid.levels, other.grid.levels)
    np.testing.assert_allclose(one.grid.bounds, other.grid.bounds, rtol=1e-6)
    for name in other.fields:
        here, there = (v.array(name).astype(float) for v in (one, other))
        np.testing.assert_allclose(here, there, rtol=1e-4, atol=1e-6 * np.abs(there).max())


def expected(kernel="cubic"):
    volume = vm.Volume.from_particles(
        (POSITIONS * KPC * u.cm).to("kpc"),
        MASSES * MSUN10 * u.g,
        smoothing_length=LENGTHS * KPC * u.cm,  # Gadget writes the radius of the support
        fields={"velocity": VELOCITIES.astype("f4") * u.km / u.s},
        kernel=kernel,
    )
    volume["density"] = volume["density"].to("g / cm3")
    return volume


def test_gadget_is_what_from_particles_makes_of_its_particles(tmp_path):
    volume = vm.open(gadget(tmp_path / "s.hdf5", smoothed()), ["density", "velocity"])
    same(volume, expected())
    assert str(volume.unit) == "kpc"
    assert volume.units == {"density": "g / cm3"} | {f"velocity_{a}": "km / s" for a in "xyz"}
    assert total(volume).to_value("g") == pytest.approx(MASSES.sum() * MSUN10, rel=1e-12)
    # Of the code's unit of time, kpc / (km/s).
    time = pytest.approx(0.5 * KPC / KMS)
    assert volume.meta == {"particles": len(MASSES), "time": time, "time_unit": "s"}


def test_particles_with_densities_or_volumes_are_cells_of_a_mesh(tmp_path):
    density = MASSES / LENGTHS**3
    one = vm.open(gadget(tmp_path / "a.hdf5", data(Density=density)), "density")
    other = vm.open(gadget(tmp_path / "b.hdf5", data(Volume=LENGTHS**3)), "density")
    same(one, other)
    # The box, which cells fill; Gadget's kpc is 1.4e-7 longer than the IAU's.
    np.testing.assert_allclose(one.grid.bounds, [[0, 10]] * 3, rtol=2e-7)
    assert total(one).to_value("g") == pytest.approx(MASSES.sum() * MSUN10, rel=1e-12)


def test_several_files_are_one_snapshot(tmp_path):
    parts = [{name: values[k::3] for name, values in smoothed().items()} for k in range(3)]
    paths = [gadget(tmp_path / f"s_1.{k}.hdf5", p, files=3) for k, p in enumerate(parts)]
    whole = vm.open(gadget(tmp_path / "whole.hdf5", smoothed()))
    for path in paths:
        same(vm.open(path), whole)
    (tmp_path / "snapdir_001").mkdir()
    for k, part in enumerate(parts):
        gadget(tmp_path / "snapdir_001" / f"s_1.{k}.hdf5", part, files=3)
    same(vm.open(tmp_path / "snapdir_001"), whole)
    told = find_reader(paths[0]).info(paths[0])
    assert {t.shape[0] for t in told} == {COUNT}
    paths[1].unlink()
    with pytest.raises(vm.InputError, match=r"s_1\.1\.hdf5"):
        vm.open(paths[0])
    paths[2].rename(tmp_path / "other.hdf5")
    with pytest.raises(vm.InputError, match="one of 3 files"):
        vm.open(tmp_path / "other.hdf5")


COSMOLOGY = {"Omega0": 0.3, "HubbleParam": 0.5, "Redshift": 1.0, "Time": 0.5}


@pytest.mark.parametrize("told", [True, False])
def test_comoving_units_become_proper_ones(tmp_path, told):
    powers = {
        "Coordinates": (1, -1),
        "Masses": (0, -1),
        "SmoothingLength": (1, -1),
        "Velocities": (0.5, 0),
    }
    attributes = {n: {"a_scaling": a, "h_scaling": h} for n, (a, h) in powers.items()}
    path = gadget(
        tmp_path / "s.hdf5",
        smoothed(),
        header=UNITS | COSMOLOGY,
        attributes=attributes if told else None,
    )
    volume = vm.open(path)
    # a = h = 1/2: kpc / h, comoving, are kpc; masses are twice what is written.
    proper = vm.open(gadget(tmp_path / "t.hdf5", smoothed() | {"Masses": 2 * MASSES}))
    proper["velocity_x"] = proper["velocity_x"] * 0.5**0.5
    np.testing.assert_allclose(volume.grid.bounds, [[0, 10]] * 3, rtol=2e-7)  # the periodic box
    assert total(volume).to_value("g") == pytest.approx(2 * MASSES.sum() * MSUN10, rel=1e-12)
    momentum = total(proper, "velocity_x")
    assert (total(volume, "velocity_x") / momentum).to_value("") == pytest.approx(1, rel=1e-9)
    assert volume.meta == {"particles": len(MASSES), "redshift": 1.0, "scale_factor": 0.5}


def test_swift_tells_units_powers_and_kernel(tmp_path):
    path, sets = tmp_path / "swift.hdf5", data(SmoothingLength=2 * LENGTHS / 1.936492)
    exponents = {  # the data set of Gadget; powers of mass, length, time and a
        "Coordinates": ("Coordinates", 0, 1, 0, 1),
        "Masses": ("Masses", 1, 0, 0, 0),
        "Velocities": ("Velocities", 0, 1, -1, 0),
        "InternalEnergies": ("InternalEnergy", 0, 2, -2, 0),
        "SmoothingLengths": ("SmoothingLength", 0, 1, 0, 1),
    }
    keys = [f"U_{k} exponent" for k in "MLt"] + ["a-scale exponent"]
    attributes = {
        name: {key: [float(n)] for key, n in zip(keys, powers, strict=True)}
        | {"h-scale exponent": [0.0]}
        for name, (_, *powers) in exponents.items()
    }
    sets = {name: sets[old] for name, (old, *_) in exponents.items()}
    gadget(path, sets, header={}, attributes=attributes)
    with h5py.File(path, "a") as file:
        for name, letter, size in zip(
            ("length", "mass", "time"), "LMt", (KPC, MSUN10, KPC / KMS), strict=True
        ):
            file.require_group("Units").attrs[f"Unit {name} in cgs (U_{letter})"] = [size]
        file.create_group("Cosmology").attrs["Cosmological run"] = [0]
        file.create_group("HydroScheme").attrs["Kernel function"] = b"Wendland C2 (C2)"
    volume = vm.open(path)
    assert volume.units["internal_energy"] == "km2 / s2"
    same(volume, expected("wendland-c2"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f["Header"].attrs.update(NumPart_ThisFile=[5, 0, 0, 0, 0, 0]), "tells of 5"),
        (lambda f: f["Header"].attrs.update(UnitMass_in_g=-1.0), "unit of mass"),
        (lambda f: f["Header"].attrs.update(Time=[1.0, 2.0]), "Time must be a number"),
        (lambda f: f["Header"].attrs.update(NumFilesPerSnapshot=-3), "one of -3 files"),
        (lambda f: f.__delitem__("PartType0/Masses"), "Masses"),
        (lambda f: _replace(f, "Masses", np.ones(COUNT + 1)), "one row for each"),
        (lambda f: _replace(f, "Coordinates", np.ones((COUNT, 2))), r"expected \(n, 3\)"),
        (lambda f: _replace(f, "SmoothingLength", np.zeros(COUNT)), "smoothing_length must be pos"),
        (
            lambda f: _replace(f, "Coordinates", np.full((COUNT, 3), np.nan)),
            "positions must be fin",
        ),
        (lambda f: _promise(f, "Masses"), "promises"),
    ],
)
def test_header_and_data_at_odds(tmp_path, change, words):
    path = gadget(tmp_path / "s.hdf5", smoothed())
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(vm.InputError, match=words) as failure:
        vm.open(path)
    assert "s.hdf5" in str(failure.value)


def _replace(file, name, values):
    del file[f"PartType0/{name}"]
    file[f"PartType0/{name}"] = values


def _promise(file, name):
    """A data set that says it is large, and has nothing in the file."""
    del file[f"PartType0/{name}"]
    file["PartType0"].create_dataset(name, (COUNT, 10**12), "f8", chunks=(1, 1 << 20))


# --- Phantom ----------------------------------------------------------------------------------

AU, MSUN, YEAR = 1.496e13, 1.989e33, 5.0227e6
HEADER = {"udist": AU, "umass": MSUN, "utime": YEAR, "umagfd": 0.1}


class Fortran:
    """Writes Fortran's unformatted records, as the manual of Phantom lists them."""

    def __init__(self, order, real, integer=4):
        self.order, self.content = order, b""
        self.types = [f"i{integer}", "i1", "i2", "i4", "i8", f"f{real}", "f4", "f8"]

    def record(self, *parts):
        content = b"".join(parts)
        marker = struct.pack(f"{self.order}i", len(content))
        self.content += marker + content + marker

    def values(self, kind, values):
        return np.asarray(values, f"{self.order}{self.types[kind]}").tobytes()

    def tag(self, name):
        return name.ljust(16).encode()

    def begin(self, identity):
        i, r = (lambda v: self.values(0, v)), (lambda v: self.values(5, v))
        self.record(i(60769), r(60878), i(60878), i(1), i(690706))
        self.record(identity.ljust(100).encode())

    def header(self, numbers):
        """Numbers: for each of the eight types, pairs of tag and value."""
        for kind in range(8):
            pairs = numbers.get(kind, [])
            self.record(self.values(0, len(pairs)))
            if pairs:
                self.record(*(self.tag(tag) for tag, _ in pairs))
                self.record(self.values(kind, [value for _, value in pairs]))

    def groups(self, groups):
        """Groups: how long arrays are, and for each type pairs of tag and array."""
        self.record(self.values(0, len(groups)))
        for count, arrays in groups:
            numbers = [len(arrays.get(kind, [])) for kind in range(8)]
            self.record(self.values(4, count), self.values(3, numbers))
        for _, arrays in groups:
            for kind, pairs in sorted(arrays.items()):
                for tag, array in pairs:
                    self.record(self.tag(tag))
                    self.record(self.values(kind, array))


def phantom(path, *, order="<", real=8, integer=4, identity="FT:Phantom:2024", **change):
    """Write a dump: two of the particles are accreted, two are dust."""
    h = LENGTHS.copy()
    h[:2] *= -1
    itype = np.ones(COUNT, int)
    itype[-2:] = 7
    file = Fortran(order, real, integer)
    file.begin(identity)
    masses = [("massoftype", m) for m in (1e-3, 0, 0, 0, 0, 0, 5e-4, 0)]
    file.header(
        {
            0: [("nparttot", COUNT), ("nblocks", change.get("nblocks", 1)), ("nptmass", 1)],
            5: [("time", 2.0), ("hfact", 1.2), *masses],
            7: list(change.get("units", HEADER).items()),
        }
    )
    vectors = [(a, POSITIONS[:, k]) for k, a in enumerate("xyz")]
    vectors += [(f"v{a}", VELOCITIES[:, k]) for k, a in enumerate("xyz")]
    gas = {1: [("itype", itype)], 5: vectors, 6: [("h", h), ("alpha", np.ones(COUNT))]}
    sinks = {5: [("x", [0.5]), ("m", [2.0])]}
    field = {6: [(f"B{a}", VELOCITIES[:, k]) for k, a in enumerate("xyz")]}
    file.groups([(COUNT, gas), (1, sinks), (0, {}), (COUNT, field)])
    path.write_bytes(file.content)
    return path


def phantom_expected(chosen, mass):
    volume = vm.Volume.from_particles(
        (POSITIONS[chosen] * AU * u.cm).to("au"),
        mass * MSUN * u.g,
        smoothing_length=LENGTHS[chosen] * AU * u.cm,
        fields={
            "velocity": VELOCITIES[chosen] * (AU / YEAR) * (u.cm / u.s).to("km / s") * u.km / u.s
        },
    )
    volume["density"] = volume["density"].to("g / cm3")
    return volume


class TestPhantom(ReaderContract):
    options = {"cell_width": 4}  # noqa: RUF012 - few cells are enough to see damage

    @pytest.fixture
    def sample(self):
        return lambda directory: phantom(directory / "dump_00001")


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("real", "integer"), [(8, 4), (4, 4), (8, 8), (4, 8)])
def test_phantom_in_all_precisions_and_orders_of_bytes(tmp_path, order, real, integer):
    path = phantom(tmp_path / "dump", order=order, real=real, integer=integer)
    volume = vm.open(path, ["density", "velocity"])
    if real == 8:
        same(volume, phantom_expected(slice(2, -2), 1e-3))
    mass = 1e-3 * (COUNT - 4) * MSUN
    assert total(volume).to_value("g") == pytest.approx(mass, rel=1e-12 if real == 8 else 1e-6)
    assert volume.meta["sinks"] == {"x": [0.5], "m": [2.0]}
    assert volume.meta["time"] == pytest.approx(2 * YEAR)


def test_phantom_dust_and_magnetic_fields(tmp_path):
    path = phantom(tmp_path / "dump")
    for kind in (7, "dust"):
        dust = vm.open(path, ["density", "velocity"], particle_type=kind)
        same(dust, phantom_expected(slice(-2, None), 5e-4))
    volume = vm.open(path)
    assert {"alpha", "smoothing_length", "magnetic_field_z"} < set(volume.fields)
    assert volume.units["magnetic_field_x"] == "G"
    momentum = total(volume, "magnetic_field_x") / total(volume)
    assert momentum.to_value("G") == pytest.approx(0.1 * VELOCITIES[2:-2, 0].mean(), rel=1e-6)
    with pytest.raises(vm.FileFormatError, match="type 3"):
        vm.open(path, particle_type="boundary")
    with pytest.raises(vm.errors.UnknownNameError, match="dust"):
        vm.open(path, particle_type="dusk")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"nblocks": 4}, "4 blocks"),
        ({"identity": "F :Phantom:1.0"}, "without tags"),
    ],
)
def test_phantom_that_is_refused(tmp_path, change, words):
    with pytest.raises(vm.FileFormatError, match=words) as failure:
        vm.open(phantom(tmp_path / "dump_00002", **change))
    assert "dump_00002" in str(failure.value)


# --- real data --------------------------------------------------------------------------------


def real(name):
    path = data_directory() / "data" / name
    if not path.exists():
        pytest.skip(f"no {name} in {data_directory()}; set VOLUMINOUS_TEST_DATA")
    return path


def test_the_two_files_of_a_disc_are_one():
    native, copy = (
        vm.open(real(f"phantom_disc/{name}"), ["density", "velocity_x"], cell_width=2)
        for name in ("disc_00001", "disc_00001.h5")
    )
    np.testing.assert_array_equal(native.grid.levels, copy.grid.levels)
    # Velocities are in single precision in the copy.
    for name in ("density", "velocity_x"):
        largest = np.abs(native.array(name)).max()
        np.testing.assert_allclose(native.array(name), copy.array(name), atol=1e-6 * largest)
    assert native.meta["sinks"]["m"] == copy.meta["sinks"]["m"]
    assert total(native).to_value("g") == pytest.approx(0.292845 * 1.9891e33, rel=1e-6)


@pytest.mark.exhaustive
def test_columns_of_a_voronoi_mesh_are_near_the_exact_ones():
    path = real("arepo_galaxies/galaxy_interaction.hdf5")
    exact = np.load(path.with_name("galaxy_interaction-proj.npy")).T
    volume = vm.open(path, "density")
    mass = total(volume).to_value("g")
    volume["density"] = volume["density"].to_value(1.989e43 * u.g / u.kpc**3)  # the code's numbers
    middle = volume.grid.bounds.mean(axis=1)
    camera = vm.Orthographic(0, 0, width=75, resolution=128, center=middle)
    image = vm.render(volume, vm.Coefficients("density", 0), camera, scheme="post-classified")
    found = image.intensity[..., 0]
    # Cells of half the width of the mesh's: 8.6 %, and 4.7 % for half of the pixels.
    assert np.abs(found - exact).sum() < 0.1 * exact.sum()
    assert np.median(np.abs(found / exact - 1)) < 0.06
    with h5py.File(path) as file:
        assert mass == pytest.approx(
            file["PartType0/Masses"][:].sum(dtype=float) * 1.989e43, rel=1e-9
        )
