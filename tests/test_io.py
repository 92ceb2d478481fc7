"""Volume files: what was saved comes back, one field costs one field, damage is named."""

import pickle
import zipfile

import h5py
import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from contracts import ReaderContract
from voluminous.files import MissingPathError
from voluminous.io import Reader, readers
from voluminous.io.names import field_name

RHO = np.arange(24, dtype=np.float32).reshape(2, 3, 4) + 1


@pytest.fixture(params=[".npz", ".h5"])
def suffix(request):
    return request.param


def test_what_was_saved_comes_back_bit_for_bit(tmp_path, suffix):
    rng = np.random.default_rng(1)
    for unit in (None, "pc", "0.5 kpc"):
        walls = [np.cumsum(rng.uniform(0.01, 10, n)) for n in (3, 2, 5)]
        volume = vm.Volume(vm.CartesianGrid(*walls, unit=unit))
        for dtype in ("f4", "f8", "i4", "i8", "u1", "?"):
            volume[f"a_{dtype.strip('?')}"] = rng.integers(0, 255, volume.grid.shape).astype(dtype)
        volume.set_unit("a_f8", "g / cm3")
        volume.save(tmp_path / f"volume{suffix}")
        again = vm.open(tmp_path / f"volume{suffix}")
        assert (again.units, again.unit) == (volume.units, volume.unit)
        for mine, theirs in zip(again.grid.edges, walls, strict=True):
            np.testing.assert_array_equal(mine, theirs)
        for name in volume.fields:
            assert again.array(name).dtype == volume.array(name).dtype
            np.testing.assert_array_equal(again.array(name), volume.array(name))


def test_saving_replaces_the_file_whole_or_not_at_all(tmp_path, suffix, monkeypatch):
    path = tmp_path / f"volume{suffix}"
    path.write_bytes(b"old")
    volume = vm.models.sphere(4)
    reader = find_reader_for(suffix)

    def interrupted(volume, path):
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(type(reader), "write", lambda self, v, p: interrupted(v, p))
    with pytest.raises(KeyboardInterrupt):
        volume.save(path)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == b"old"


def find_reader_for(suffix):
    return next(reader for reader in readers() if suffix in reader.suffixes)


def test_saving_needs_a_known_format(tmp_path):
    with pytest.raises(vm.errors.UnknownNameError, match=r"'\.h6'; did you mean '\.h5'"):
        vm.models.sphere(4).save(tmp_path / "volume.h6")
    with pytest.raises(vm.errors.UnknownNameError, match="unknown volume format"):
        vm.models.sphere(4).save(tmp_path / "volume.npy")


# What people have lying about


def test_npz_made_by_hand(tmp_path):
    path = tmp_path / "a.npz"
    bounds = [[-1, 1], [0, 3], [0, 4]]
    np.savez(path, rho=RHO, rho_unit="g/cm3", T=RHO * 2, bounds=bounds, unit="pc", name="x")
    volume = vm.open(path)
    assert volume.fields == ("rho", "T")
    assert volume.units == {"rho": "g / cm3", "T": ""}
    assert volume.unit == u.pc
    np.testing.assert_array_equal(volume.grid.bounds, bounds)
    np.testing.assert_array_equal(volume.array("T"), RHO * 2)


def test_npy_has_one_field(tmp_path):
    path = tmp_path / "gas density.npy"
    np.save(path, RHO)
    volume = vm.open(path, unit="km", spacing=[1, 2, 3])
    assert volume.fields == ("gas_density",)
    assert volume.grid.bounds.tolist() == [[0, 2], [0, 6], [0, 12]]
    np.testing.assert_array_equal(volume.array("gas_density"), RHO)
    assert vm.open(path, name="rho").fields == ("rho",)


def test_axes_in_another_order(tmp_path):
    np.savez(tmp_path / "a.npz", rho=RHO.transpose(2, 1, 0), bounds=[[0, 2], [0, 3], [0, 4]])
    volume = vm.open(tmp_path / "a.npz", axes="zyx")
    np.testing.assert_array_equal(volume.array("rho"), RHO)
    np.save(tmp_path / "a.npy", RHO.transpose(1, 2, 0))
    np.testing.assert_array_equal(vm.open(tmp_path / "a.npy", axes="yzx").array("a"), RHO)
    with pytest.raises(vm.InputError, match="axes must be x, y and z"):
        vm.open(tmp_path / "a.npy", axes="xyy")


@pytest.fixture
def snapshot(tmp_path):
    """An HDF5 file as codes write them."""
    path = tmp_path / "snapshot.hdf5"
    with h5py.File(path, "w") as file:
        file["gas/rho"] = RHO
        file["gas/rho"].attrs["units"] = "g/cm**3"
        file["gas/x-velocity"] = RHO.astype(">f4")
        file["gas/x-velocity"].attrs["unit"] = np.bytes_("km/s")
        file["gas/e"] = RHO
        file["gas/e"].attrs["units"] = "code_energy"
        file["coarse/rho"] = RHO[:1]
        for axis, n in zip("xyz", RHO.shape, strict=True):
            file[f"grid/{axis}"] = np.arange(n + 1.0)
            file[f"grid/{axis}"].attrs["units"] = "AU"
        file["time"] = 1.0
    return path


def test_hdf5_by_paths(snapshot):
    edges = {axis: f"/grid/{axis}" for axis in "xyz"}
    volume = vm.open(snapshot, {"density": "/gas/rho"}, **edges)
    assert volume.fields == ("density",)
    assert volume["density"].unit == u.g / u.cm**3
    assert volume.unit == u.AU
    volume = vm.open(snapshot, ["gas/x-velocity", "/gas/e"])
    assert volume.units == {"x_velocity": "km / s", "e_": ""}
    assert volume.grid.bounds.tolist() == [[0, 2], [0, 3], [0, 4]]
    assert vm.open(snapshot, "gas/rho").fields == ("rho",)


def test_hdf5_all_fields_must_have_one_shape_and_distinct_names(snapshot):
    with pytest.raises(vm.InputError, match=r"both be called 'rho'.*fields="):
        vm.open(snapshot)
    with pytest.raises(vm.InputError, match=r"one shape.*b \(1, 3, 4\)"):
        vm.open(snapshot, {"a": "gas/rho", "b": "coarse/rho"})


def test_a_name_that_is_not_there_names_the_nearest(snapshot):
    with pytest.raises(
        vm.errors.UnknownNameError, match=r"snapshot.*'gas/roh'; did you mean 'gas/rho'"
    ):
        vm.open(snapshot, "gas/roh")
    with pytest.raises(vm.errors.UnknownNameError, match="'spacng'; did you mean 'spacing'"):
        vm.open(snapshot, "gas/rho", spacng=2)
    with pytest.raises(
        vm.errors.UnknownNameError, match="unknown format 'hdf'; did you mean 'hdf5'"
    ):
        vm.open(snapshot, format="hdf")
    with pytest.raises(vm.errors.UnknownNameError, match="unknown array '/grid/xx'"):
        vm.open(snapshot, "gas/rho", x="/grid/xx", y="/grid/y", z="/grid/z")


def test_contradicting_options(snapshot):
    with pytest.raises(vm.InputError, match="not several of them"):
        vm.open(snapshot, "gas/rho", spacing=1, bounds=(0, 1))
    with pytest.raises(vm.InputError, match="y, z missing"):
        vm.open(snapshot, "gas/rho", x="/grid/x")
    with pytest.raises(vm.InputError, match="spacing must be a positive"):
        vm.open(snapshot, "gas/rho", spacing=-1)
    with pytest.raises(vm.UnitsError, match="'parsecc' is not a unit"):
        vm.open(snapshot, "gas/rho", unit="parsecc")


@pytest.mark.parametrize(
    ("array", "expected"),
    [
        (np.ones((3, 4)), r"three axes.*|expected a three-dimensional"),
        (np.ones((3, 4, 5, 3)), "components of a vector as three fields"),
        (np.ones((0, 4, 4)), "at least one cell"),
        (np.ones((2, 2, 2), complex), "real numbers"),
        (np.full((2, 2, 2), "a"), "real numbers"),
    ],
)
def test_arrays_that_make_no_field(tmp_path, array, expected):
    np.savez(tmp_path / "a.npz", rho=array)
    np.save(tmp_path / "rho.npy", array)
    for name in ("a.npz", "rho.npy"):
        with pytest.raises(vm.FileFormatError, match=expected) as failure:
            vm.open(tmp_path / name, "rho")
        assert name in str(failure.value)
    if array.ndim != 3 or array.dtype.kind not in "f":
        with pytest.raises(vm.FileFormatError, match="expected a three-dimensional array"):
            vm.open(tmp_path / "a.npz")


class Evil:
    """An object that does something when it is unpickled."""

    ran = False

    def __reduce__(self):
        return (setattr, (Evil, "ran", True))


def test_objects_are_never_unpickled(tmp_path):
    array = np.full((2, 2, 2), Evil(), dtype=object)
    np.savez(tmp_path / "a.npz", rho=array)
    np.save(tmp_path / "a.npy", array)
    for path, name in ((tmp_path / "a.npz", "rho"), (tmp_path / "a.npy", "a")):
        with pytest.raises(vm.FileFormatError, match="Python objects"):
            vm.open(path, name)
    assert not Evil.ran
    (tmp_path / "b.npy").write_bytes(pickle.dumps(Evil()))
    with pytest.raises(vm.FileFormatError, match="is named like a NumPy array"):
        vm.open(tmp_path / "b.npy")
    assert not Evil.ran


# Damage


def test_wrong_and_missing_files(tmp_path):
    with pytest.raises(MissingPathError, match="there is no file"):
        vm.open(tmp_path / "a.h5")
    with pytest.raises(FileNotFoundError):
        vm.open(tmp_path / "a.h5")
    (tmp_path / "empty.h5").touch()
    with pytest.raises(vm.FileFormatError, match="is empty"):
        vm.open(tmp_path / "empty.h5")
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(vm.FileFormatError, match=r"does not know.*b'hello'.*hdf5 \(\.h5"):
        vm.open(tmp_path / "a.txt")
    with pytest.raises(vm.FileFormatError, match="is a directory"):
        vm.open(tmp_path)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("readme.txt", "no array")
    with pytest.raises(vm.FileFormatError, match="the file holds nothing"):
        vm.open(tmp_path / "a.npz")


# Names


@pytest.mark.parametrize(
    ("place", "name"),
    [
        ("gas/rho", "rho"),
        ("x-velocity", "x_velocity"),
        ("3d", "_3d"),
        ("e", "e_"),
        ("log", "log_"),
        ("in", "in_"),
    ],
)
def test_field_names_can_be_used_in_expressions(place, name):
    assert field_name(place) == name
    vm.Volume(vm.CartesianGrid.uniform(1, (0, 1)), {name: np.ones((1, 1, 1))})


# Readers of other packages


class LineReader(Reader):
    """The smallest reader there can be: the number of cells in a text file."""

    name = "line"
    description = "a line"
    suffixes = (".line",)
    options = {"value": "what to fill it with"}  # noqa: RUF012

    def matches(self, path, head):
        return head.startswith(b"line ")

    def read(self, path, fields=None, value=1.0):
        n = int(path.read_text().split()[1])
        return vm.Volume(vm.CartesianGrid.uniform(n, (0, 1)), a=np.full((n, n, n), value))

    def info(self, path, **options):
        return ()


class Entry:
    """An entry point, without a package to have it."""

    name, value = "line", "lines:LineReader"

    def __init__(self, target):
        self.target = target

    def load(self):
        if self.target is None:
            raise ImportError("no module lines")
        return self.target


def test_other_packages_bring_readers(tmp_path, entry_points):
    entry_points.append(Entry(LineReader))
    (tmp_path / "a.line").write_text("line 3")
    volume = vm.open(tmp_path / "a.line", value=2.0)
    assert volume.grid.shape == (3, 3, 3)
    assert volume.array("a")[0, 0, 0] == 2.0
    with pytest.raises(
        vm.errors.UnknownNameError, match="line option 'valu'; did you mean 'value'"
    ):
        vm.open(tmp_path / "a.line", valu=2.0)
    (tmp_path / "b.line").write_text("line x")
    with pytest.raises(vm.FileFormatError, match=r"b\.line: expected a line.*ValueError"):
        vm.open(tmp_path / "b.line")


def test_a_broken_package_breaks_nothing_else(tmp_path, entry_points):
    entry_points.append(Entry(None))
    np.save(tmp_path / "a.npy", RHO)
    with pytest.warns(UserWarning, match=r"'line' \(lines:LineReader\) cannot be loaded"):
        assert vm.open(tmp_path / "a.npy").fields == ("a",)


@pytest.mark.parametrize("reader", readers(), ids=lambda reader: reader.name)
def test_readers_keep_the_contract(reader, tmp_path):
    assert reader.name
    assert reader.description.split()[0] in ("a", "an")
    assert all(s.startswith(".") and s == s.lower() for s in reader.suffixes)
    assert all(reader.options.values())
    assert not reader.matches(tmp_path / "nothing", b"")
    if not reader.writes:
        with pytest.raises(vm.InputError, match="cannot write"):
            reader.write(vm.models.sphere(2), tmp_path / "a")


class TestNPZ(ReaderContract):
    @pytest.fixture
    def sample(self):
        def write(directory):
            np.savez(directory / "a.npz", rho=RHO, x=[0, 1, 2], y=[0, 1, 2, 3], z=[0, 1, 2, 3, 4])
            return directory / "a.npz"

        return write


class TestHDF5(ReaderContract):
    @pytest.fixture
    def sample(self):
        def write(directory):
            vm.models.sphere(6).save(directory / "a.h5")
            return directory / "a.h5"

        return write
