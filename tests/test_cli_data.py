"""Data files on the command line: info, render, convert and formats."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy import units as u
from astropy.wcs import WCS

import voluminous as vm
from test_io import Entry
from voluminous.cli import data, main
from voluminous.cli import statistics as stats
from voluminous.io import Reader, readers

# Small pictures, quickly made.
FAST = ["--set", "camera.resolution=8", "--scheme", "first-order"]


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """All paths are relative to an empty working directory."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def snapshot():
    """A file with several fields, of which the density is not the first."""
    rng = np.random.default_rng(0)
    volume = vm.Volume(vm.CartesianGrid.uniform((4, 5, 6), (-1, 1), unit="pc"))
    volume["velocity_x"] = rng.normal(size=(4, 5, 6)) * u.km / u.s
    volume["level"] = np.zeros((4, 5, 6), np.uint8)
    volume["temperature"] = rng.lognormal(5, 2, (4, 5, 6)) * u.K
    volume["rho"] = rng.lognormal(0, 3, (4, 5, 6)).astype(np.float32) * u.g / u.cm**3
    volume.meta.update(time=1.5, redshift=0.25, note="first\nsecond")
    volume.save("snapshot.h5")
    return volume


def run(*arguments):
    return main([str(argument) for argument in arguments])


def told(capsys, *arguments):
    """Return what a command says; it must succeed."""
    assert run(*arguments) == 0
    return capsys.readouterr().out


def refused(capsys, *arguments):
    """Return the error of a command that must fail."""
    before = sorted(Path().rglob("*"))
    assert run(*arguments) == 2
    assert sorted(Path().rglob("*")) == before
    return capsys.readouterr().err


# Which field is looked at first


@pytest.mark.parametrize(
    ("names", "first"),
    [
        (("dust_density", "rho"), "rho"),
        (("temperature", "dust_density"), "dust_density"),
        (("velocity_x", "pressure", "temperature"), "pressure"),
        (("ra", "velocity", "flux"), "flux"),
        (("level", "index"), "level"),
    ],
)
def test_the_first_field(names, first):
    volume = vm.Volume(vm.CartesianGrid.uniform(2, (0, 1)))
    for name in names:
        volume[name] = np.arange(8.0).reshape(2, 2, 2)
    assert data.first_field(volume) == first


def test_only_the_field_that_is_shown_is_read(snapshot):
    snapshot.save("snapshot.h5", compress=True)
    with h5py.File("snapshot.h5", "r+") as file:
        for name in {*snapshot.fields} - {"rho"}:
            file["fields"][name].id.write_direct_chunk((0, 0, 0), b"no gzip at all")
    assert run("render", "snapshot.h5", *FAST) == 0


# render


def test_render_says_what_it_chose(snapshot, capsys):
    out = told(capsys, "render", "snapshot.h5", *FAST)
    first, second, third = out.splitlines()
    assert re.match(r"log10\(rho\): 4 shells at .* \(rho in g / cm3\), seen from incl 60", first)
    assert second == "other fields (--field): velocity_x, level, temperature"
    assert third.startswith("snapshot.png: 8 x 8 pixels")
    scene = vm.Scene.load("snapshot.png").to_dict()
    assert scene["volume"] == {"path": "snapshot.h5", "fields": ["rho"]}


def test_render_takes_options_of_the_format_and_of_the_scene(capsys):
    np.save("cube.npy", np.random.default_rng(0).random((4, 4, 4)))
    options = ["--set", "unit=pc", "--set", "volume.spacing=0.5", "--format", "npy"]
    assert run("render", "cube.npy", *options, *FAST, "-q") == 0
    made = vm.Scene.load("cube.png")
    assert made.to_dict()["volume"] == {
        "path": "cube.npy",
        "format": "npy",
        "fields": ["cube"],
        "unit": "pc",
        "spacing": 0.5,
    }
    assert made.volume().unit == u.pc
    assert made.volume().grid.bounds.tolist() == [[0, 2]] * 3
    assert vm.Image.load("cube.png").unit == "pc"
    # The picture is a scene with all that, wherever it is rendered again.
    assert run("render", "cube.png", "-o", "again.png", "-q") == 0
    assert Path("again.png").read_bytes()[:4] == b"\x89PNG"


def test_fields_that_do_not_fit_together(capsys):
    rng = np.random.default_rng(0)
    with h5py.File("mixed.h5", "w") as file:
        file["coarse/temperature"] = rng.random((2, 2, 2))
        file["fine/density"] = rng.random((4, 4, 4))
        file["other/density"] = rng.random((3, 3, 3))
    out = told(capsys, "render", "mixed.h5", *FAST)
    assert out.startswith("density: 4 shells")
    fields = vm.Scene.load("mixed.png").to_dict()["volume"]["fields"]
    assert fields == {"density": "fine/density"}
    out = told(capsys, "render", "mixed.h5", "--field", "2 * temperature", *FAST)
    assert out.startswith("2 * temperature: 4 shells")
    out = told(capsys, "info", "mixed.h5")
    assert out.count("grid: cartesian") == 3
    assert "2 x 2 x 2 cells" in out


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--format", "hd5"], "unknown format 'hd5'; did you mean 'hdf5'"),
        (["--set", "unti=pc"], "unknown voluminous option 'unti'"),
        (["--field", "rhoo"], "did you mean 'rho'"),
    ],
)
def test_mistakes_in_rendering_data(snapshot, capsys, arguments, expected):
    assert expected in refused(capsys, "render", "snapshot.h5", *arguments)


def test_a_camera_that_is_set_needs_no_angles(snapshot, capsys):
    place = ["--set", "camera.position=[5, 4, 3]", "--set", "camera.target=[0, 0, 0]"]
    out = told(capsys, "render", "snapshot.h5", *FAST, "--set", "camera.type=perspective", *place)
    assert "incl" not in out
    assert vm.Scene.load("snapshot.png").camera.describe()["type"] == "perspective"
    told(capsys, "render", "snapshot.h5", *FAST, "--set", "camera.view_direction=[1, 0, 0]")
    assert "seen from incl 20, phi 30" in told(
        capsys, "render", "snapshot.h5", *FAST, "--set", "camera.incl=20"
    )
    Path("snapshot.png").unlink()
    # What the user said is not dropped.
    for said in (["--incl", "3"], ["--set", "camera.incl=3"]):
        assert "unknown key 'incl'" in refused(
            capsys, "render", "snapshot.h5", *said, "--set", "camera.type=perspective", *place
        )


def test_views_by_name(snapshot, capsys):
    assert "set volume.meta['orientation']" in refused(
        capsys, "render", "snapshot.h5", "--view", "left"
    )
    snapshot.meta["orientation"] = "LPS"
    snapshot.save("patient.h5")
    assert "seen from incl 90, phi 0" in told(capsys, "render", "patient.h5", *FAST)
    assert "seen from incl 180, phi 0" in told(
        capsys, "render", "patient.h5", *FAST, "--view", "inferior"
    )
    assert "not both" in refused(
        capsys, "render", "patient.h5", "--view", "left", "--incl", "3", "-o", "a.png"
    )


# info


def test_info_tells_all_there_is(snapshot, capsys):
    wcs = WCS(naxis=3)
    wcs.wcs.ctype, wcs.wcs.crval = ["RA---TAN", "DEC--TAN", "VRAD"], [12.5, -30, 1000]
    wcs.wcs.cunit = ["deg", "deg", "m/s"]
    wcs.wcs.set()
    snapshot.wcs = wcs
    snapshot.save("snapshot.h5")
    out = told(capsys, "info", "snapshot.h5")
    assert "snapshot.h5: a volume saved by voluminous (HDF5), " in out
    for line in ("time: 1.5", "redshift: 0.25", "note: first …"):
        assert f"\n{line}\n" in out
    assert "world axis RA---TAN (pos.eq.ra): reference 12.5 deg" in out
    assert "rho: float32, 4 x 5 x 6, g / cm3" in out
    assert "\nmemory: 2.461 KiB for all, 960 bytes for one field\n" in out
    assert out.count("|  l") == 4


def test_what_info_says_to_type_works(snapshot, capsys):
    np.savez("b.npz", rho=snapshot.array("rho"), y=np.ones((2, 2)))
    options = ["--set", "bounds=[[0, 1], [0, 2], [0, 3]]", "--set", "unit=pc"]
    out = told(capsys, "info", "b.npz", *options, "--format", "npz")
    command = re.search(r"^  voluminous (render .*)$", out, re.MULTILINE)[1]
    assert main([*shlex.split(command), *FAST, "-q"]) == 0
    assert vm.Scene.load("b.png").volume().grid.bounds.tolist() == [[0, 1], [0, 2], [0, 3]]
    names = {"vm": vm}
    exec(re.search(r"^  (volume = .*)$", out, re.MULTILINE)[1], names)
    assert names["volume"].unit == u.pc
    Path("scene.toml").write_text(out[out.index("[volume]") :])
    scene = vm.Scene.load("scene.toml")
    assert scene.volume().grid.bounds.tolist() == [[0, 1], [0, 2], [0, 3]]
    assert scene.render(scheme="first-order").intensity.max() > 0


def test_info_shows_the_scene_that_would_be_drawn(snapshot, capsys):
    snapshot.meta["time_unit"] = ""
    snapshot.save("snapshot.h5")
    out = told(capsys, "info", "snapshot.h5")
    assert "time_unit" not in out
    Path("scene.toml").write_text(out[out.index("[volume]") :])
    shown = vm.Scene.load("scene.toml")
    assert run("render", "snapshot.h5", "--set", "camera.resolution=8", "-q") == 0
    drawn = vm.Scene.load("snapshot.png")
    pairs = list(zip(shown.medium.components(), drawn.medium.components(), strict=True))
    assert len(pairs) == 4
    for short, full in pairs:
        assert (type(short), short.expr) == (type(full), full.expr)
        assert short.opacity == pytest.approx(full.opacity, rel=5e-4)  # four digits
        assert short.path_length.to_value("pc") == pytest.approx(full.path_length, rel=5e-4)
        assert short.center == pytest.approx(full.center, abs=0.01 * full.width)
    numbers = re.findall(r"\d+\.\d+", out[out.index("[[medium]]") :])
    assert max(len(number.replace(".", "").lstrip("0")) for number in numbers) <= 5


def test_info_of_some_fields_of_which_one_is_damaged(snapshot, capsys):
    snapshot.save("snapshot.h5", compress=True)
    with h5py.File("snapshot.h5", "r+") as file:
        file["fields/temperature"].id.write_direct_chunk((0, 0, 0), b"no gzip at all")
    out = told(capsys, "info", "snapshot.h5", "--fields", "n=rho,temperature", "--no-histogram")
    assert "temperature: float64, 4 x 5 x 6, K\n  cannot be read: snapshot.h5" in out
    assert "\nn: float32, 4 x 5 x 6, g / cm3\n" in out
    assert "|" not in out
    assert "\nmore fields (--fields): rho, velocity_x, level\n" in out
    assert "did you mean 'rho'" in refused(capsys, "info", "snapshot.h5", "--fields", "roh")


@pytest.mark.parametrize("dtype", ["f4", "u1", "?"])
def test_statistics_in_pieces_are_those_of_the_whole(dtype):
    values = (np.random.default_rng(1).random((600, 500, 8)) * 9).astype(dtype)
    if dtype == "f4":
        values[1, 2, 0] = values[2, 0, 0] = np.nan
        values[3, 0, 1] = -np.inf
    good = values[np.isfinite(values)]
    found = stats.statistics(values)
    assert (found.size, found.finite) == (values.size, good.size)
    assert (found.least, found.greatest) == (good.min(), good.max())
    assert found.positive == good[good > 0].min()
    # Sums of 2.4 million numbers, in another order.
    assert found.total == pytest.approx(good.sum(dtype=float), rel=1e-13)
    if dtype == "f4":
        text = stats.numbers(found, values.shape)
        assert "2 NaN (first at [1, 2, 0]), 1 infinite (first at [3, 0, 1])" in text
        array = np.array([1.0, 20.0, 400.0, 20.0])
        _, bars, scale = stats.histogram(array, stats.statistics(array)).split("|")
        assert [bars[0], bars[-1], bars.count("█"), scale] == ["▄", "▄", 1, "  logarithmic"]
    assert stats.numbers(stats.statistics(np.full(3, np.nan))) == "no finite value, 3 NaN"


# convert


class Lossy(Reader):
    """Numbers alone, in single precision."""

    name, description, suffixes, writes = "lossy", "a file of numbers", (".los",), True

    def matches(self, path, head):
        return False

    def read(self, path, fields=None, **options):
        values = np.frombuffer(path.read_bytes(), np.float32)
        grid = vm.OctreeGrid([0, 1], [0, 1], np.arange(len(values) + 1.0))
        return vm.Volume(grid, values=values)

    def write(self, volume, path):
        path.write_bytes(volume.array(volume.fields[0]).astype(np.float32).tobytes())


def test_convert_tells_of_all_that_changed(snapshot, capsys, entry_points):
    entry_points.append(Entry(Lossy))
    out = told(
        capsys, "convert", "snapshot.h5", "a.los", "--fields", "temperature", "--to", "lossy"
    )
    assert out.splitlines()[2:] == [
        "  the grid is octree there, cartesian here",
        "  temperature is called values there",
        "  temperature: dtype float64 became float32",
        "  temperature: unit K became none",
        "  left out: time, redshift, note",
    ]


def test_convert_computes_and_chooses(snapshot, capsys):
    options = ["--expr", "mass=rho * 2", "--expr", "heavy=mass * 3", "--fields", "rho,heavy"]
    assert run("convert", "snapshot.h5", "a.h5", *options) == 0
    again = vm.open("a.h5")
    assert again.fields == ("rho", "mass", "heavy")
    assert again.units["heavy"] == "g / cm3"
    np.testing.assert_array_equal(again.array("heavy"), snapshot.array("rho") * 2 * 3)


@pytest.mark.parametrize("large", [False, True])
def test_convert_resamples(snapshot, capsys, monkeypatch, large):
    """What does not fit into memory is made box by box."""
    monkeypatch.setattr("voluminous.cli.convert.fits", lambda needed: not large)
    x = np.linspace(0, 1, 3)
    tree = vm.OctreeGrid(x, x, x, [1] + 15 * [0], unit="kpc")
    volume = vm.Volume(tree, density=np.arange(15.0) * u.K)
    volume.meta["time"] = 2.0
    volume.save("tree.h5")
    assert "holds Cartesian grids only" in refused(capsys, "convert", "tree.h5", "tree.npz")
    assert run("convert", "tree.h5", "tree.npz", "--resample", "4x4x4") == 0
    again = vm.open("tree.npz")
    assert (again.grid.shape, again.unit) == ((4, 4, 4), u.kpc)
    # Means over cells keep the integral, to rounding.
    whole = float((volume.array("density") * tree.cell_volumes).sum())
    assert float(again.array("density").mean()) == pytest.approx(whole, rel=1e-14)
    for wrong in ("4x4", "0x4x4", "axbxc", "4x4x-4"):
        assert "three numbers" in refused(capsys, "convert", "tree.h5", "a.h5", "--resample", wrong)


def test_convert_overwrites_only_when_told_and_keeps_everything(snapshot, capsys):
    Path("a.h5").write_bytes(b"precious")
    assert "--overwrite" in refused(capsys, "convert", "snapshot.h5", "a.h5")
    assert Path("a.h5").read_bytes() == b"precious"
    out = told(capsys, "convert", "snapshot.h5", "a.h5", "--overwrite")
    assert out.startswith("a.h5: a volume saved by voluminous (HDF5), ")
    assert "left out" not in out
    again = vm.open("a.h5")
    assert (again.meta, again.units) == (snapshot.meta, snapshot.units)
    for name in snapshot.fields:
        np.testing.assert_array_equal(again.array(name), snapshot.array(name))
    assert (
        run("convert", "a.h5", "a.h5", "--overwrite", "--fields", "rho", "-q") == 0
    )  # onto itself
    assert capsys.readouterr().out == ""
    np.testing.assert_array_equal(vm.open("a.h5").array("rho"), snapshot.array("rho"))


@pytest.mark.filterwarnings("ignore:RADMC-3D will refuse this grid")  # its cells are no cubes
def test_convert_writes_directories_whole_or_not_at_all(snapshot, capsys, monkeypatch):
    expr = ["--expr", "gas_density=rho", "--fields", "gas_density", "--to", "radmc3d"]
    assert run("convert", "snapshot.h5", "model", *expr) == 0
    again = vm.open("model")
    np.testing.assert_allclose(again.array("gas_density"), snapshot.array("rho"), rtol=1e-15)
    assert "is there already" in refused(capsys, "convert", "snapshot.h5", "model", *expr)
    assert "or remove it first" in refused(
        capsys, "convert", "snapshot.h5", "model", *expr, "--overwrite"
    )
    writer = next(reader for reader in readers() if reader.name == "radmc3d")

    def broken(self, volume, path, **options):
        (path / "amr_grid.inp").write_text("1\n")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(type(writer), "write", broken)
    assert "cannot save other: there is no space left" in refused(
        capsys, "convert", "snapshot.h5", "other", *expr
    )


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["a.xyz"], "unknown volume format '.xyz'"),
        (["a.h5", "--to", "hdf"], "format that can be written"),
        (["a.npz", "--compress"], "the format npz has no such option"),
        (["a.h5", "--expr", "rho"], "--expr expects NAME=EXPRESSION"),
        (["a.h5", "--fields", ","], "--fields expects"),
        (["."], "is there already"),
    ],
)
def test_mistakes_in_converting(snapshot, capsys, arguments, expected):
    assert expected in refused(capsys, "convert", "snapshot.h5", *arguments)


# formats


def test_formats_are_listed(capsys):
    out = told(capsys, "formats")
    lines = out.splitlines()
    names = [line.split()[0] for line in lines[1 : lines.index("")]]
    assert names == sorted((reader.name for reader in readers()), key=str.lower)
    assert re.search(r"^voluminous +rw +\.h5 \.hdf5 +a volume saved", out, re.MULTILINE)
    for reader in readers():
        page = told(capsys, "formats", reader.name)
        assert all(f"\n  {name} " in page for name in reader.options)
    assert "did you mean 'npz'" in refused(capsys, "formats", "npzz")


# Paths


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("snapshto.h5", "snapshot.h5"),
        ("rusn/a/x.toml", "runs/a/x.toml"),
    ],
)
def test_a_mistyped_path_is_told_the_nearest(capsys, snapshot, typed, meant):
    Path("runs/a").mkdir(parents=True)
    Path("runs/a/x.toml").touch()
    said = f"there is no file {Path(typed)}; did you mean {Path(meant)}?"
    if not Path(typed).exists():  # where names in capitals are other names
        for command in ("info", "render"):
            assert said in refused(capsys, command, typed)
        for load in (vm.open, vm.Scene.load):
            with pytest.raises(FileNotFoundError, match=re.escape(said)):
                load(typed)
