"""Files of simulation codes, found by their content and read by yt."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from reference import data_directory
from voluminous.io import find_reader
from voluminous.io.yt.reader import code_output

yt = pytest.importorskip("yt")
yt.set_log_level(50)
RNG = np.random.default_rng(5)
ROOT, FINE = RNG.uniform(1, 2, (8, 8, 8)), RNG.uniform(1, 2, (8, 4, 8))


def write_gdf(path):
    """Write two grids with yt's own writer."""
    from yt.utilities.grid_data_format.writer import write_to_gdf

    boxes = [([0, 0, 0], [1, 1, 1], 0, ROOT), ([0.25] * 3, [0.75, 0.5, 0.75], 1, FINE)]
    grids = [
        {
            "left_edge": left,
            "right_edge": right,
            "level": level,
            "dimensions": values.shape,
            "density": (values, "g/cm**3"),
            "temperature": (2 * values, "K"),
        }
        for left, right, level, values in boxes
    ]
    ds = yt.load_amr_grids(grids, [8, 8, 8], length_unit="pc")
    write_to_gdf(ds, str(path), [("gas", "density"), ("gas", "temperature")])
    return path


class TestContract(ReaderContract):
    @pytest.fixture
    def sample(self):
        return lambda directory: write_gdf(directory / "small.gdf")

    test_damaged_bytes_give_our_errors_only = None  # what damage does is up to yt and libhdf5


def test_a_file_comes_back_as_it_was_written(tmp_path):
    volume = vm.open(write_gdf(tmp_path / "x.gdf"), unit="pc")
    whole, part = volume.grid.unpack(volume.array("density"))
    np.testing.assert_array_equal(part, FINE)
    seen = np.isfinite(whole)
    assert seen.sum() == 512 - FINE.size // 8
    np.testing.assert_array_equal(whole[seen], ROOT[seen])
    assert volume.units == {"density": "g / cm3", "temperature": "K"}


def write_amrex(directory, ratios=(2,)):
    """Write a plotfile by hand: text headers, and boxes of x-fastest numbers."""
    boxes = [((0, 0, 0), ROOT), ((2, 2, 2), FINE)]
    boxes += [((2, 2, 2), RNG.uniform(1, 2, (4,) * 3))] * (len(ratios) - 1)
    sizes = [int(np.prod(ratios[:level])) for level in range(len(ratios) + 1)]
    lines = ["HyperCLaw-V1.1", "1", "density", "3", "0.5", str(len(ratios)), "0 0 0", "1 1 1"]
    lines += [" ".join(map(str, ratios))]
    lines += [" ".join(f"((0,0,0) ({8 * n - 1},{8 * n - 1},{8 * n - 1}) (0,0,0))" for n in sizes)]
    lines += [" ".join(f"{1000 * n}" for n in sizes)]  # steps of each level
    lines += [" ".join([repr(0.125 / n)] * 3) for n in sizes] + ["0", "0"]
    for level, (size, (first, values)) in enumerate(zip(sizes, boxes, strict=True)):
        width, place = 0.125 / size, directory / f"Level_{level}"
        place.mkdir(parents=True)
        low = [size * a for a in first]
        lines += [f"{level} 1 0.5", "3"]
        lines += [f"{a * width} {(a + n) * width}" for a, n in zip(low, values.shape, strict=True)]
        lines.append(f"Level_{level}/Cell")
        high = tuple(a + n - 1 for a, n in zip(low, values.shape, strict=True))
        box = f"(({low[0]},{low[1]},{low[2]}) ({high[0]},{high[1]},{high[2]}) (0,0,0))"
        form = "((8, (64 11 52 0 1 12 0 1023)),(8, (8 7 6 5 4 3 2 1)))"
        (place / "Cell_D_00000").write_bytes(
            f"FAB {form}{box} 1\n".encode() + values.tobytes(order="F")
        )
        head = f"1\n1\n1\n0\n(1 0\n{box}\n)\n1\nFabOnDisk: Cell_D_00000 0\n\n"
        extremes = f"1,1\n{values.min()},\n\n1,1\n{values.max()},\n"
        (place / "Cell_H").write_text(head + extremes)
    (directory / "Header").write_text("\n".join(lines) + "\n")
    return directory, [values for _, values in boxes]


def test_an_amrex_plotfile(tmp_path):
    path, _ = write_amrex(tmp_path / "plt00010")
    volume = vm.open(path)
    assert find_reader(path).name == "yt"
    assert find_reader(path / "Header").name == "yt"
    whole, part = volume.grid.unpack(volume.array("density"))
    np.testing.assert_array_equal(part, FINE)
    assert np.isfinite(whole).sum() == 512 - FINE.size // 8
    np.testing.assert_array_equal(whole[np.isfinite(whole)], ROOT[np.isfinite(whole)])
    assert volume.meta["time"] == 0.5


@pytest.mark.parametrize("ratios", [(4,), (2, 2), (4, 2), (2, 4), (4, 2, 4)])
def test_amrex_levels_of_different_ratios(tmp_path, ratios):
    path, boxes = write_amrex(tmp_path / "plt00020", ratios)
    volume = vm.open(path)
    levels = volume.grid.unpack(volume.array("density"))
    for found, values in zip(levels[:2], boxes, strict=False):
        seen = np.isfinite(found)
        assert seen.any()
        np.testing.assert_array_equal(found[seen], values[seen])
    np.testing.assert_array_equal(levels[-1], boxes[-1])


@pytest.mark.parametrize(
    ("items", "attributes"),
    [
        (("bounding box", "node type"), {}),
        (("Chombo_global",), {"num_levels": 1}),
        (("gridded_data_format",), {}),
        (("Info/KeyInfo",), {}),
        (("Info", "Levels", "LogicalLocations", "Locations/x"), {}),
        ((), {"bounds": 1, "domain": 1, "dims": 1}),
    ],
)
def test_layouts_are_told_without_yt(items, attributes, tmp_path):
    path = tmp_path / "x.h5"
    with h5py.File(path, "w") as file:
        for item in items:
            file.create_group(item)
        file.attrs.update(attributes)
    head = path.read_bytes()[:4096]
    assert code_output(path, head) == path
    with h5py.File(path, "w") as file:
        file["density"] = np.zeros((2, 2, 2))
    assert code_output(path, path.read_bytes()[:4096]) is None
    assert find_reader(path).name == "hdf5"


def real(place):
    """Return the path of real data, or skip the test if it is absent."""
    path = data_directory() / "data" / place
    if not path.exists():
        pytest.skip(f"no {path}; set VOLUMINOUS_TEST_DATA")
    return path


def compared(volume, path, fields):
    """Compare a volume with all cells that yt reads of a file."""
    cells = yt.load(str(path)).all_data()
    number = volume.grid.locate(cells.fcoords.to(str(volume.unit)).d)
    assert sorted(number) == list(range(volume.grid.size))
    for name in fields:
        np.testing.assert_array_equal(volume.array(name)[number], cells["gas", name].d)


RAMSES = "ramses_hii_outflow/output_00003"


def test_a_ramses_output():
    path = real(RAMSES)
    volume = vm.open(path)
    assert volume.grid.cells_per_level == (29290, 23769, 24180, 66080)
    compared(volume, path / "info_00003.txt", ["density", "velocity_x"])
    cells = volume.grid.cell_volumes  # pc³, the code's unit
    density = volume.array("density") / 1.66e-24
    velocity_unit = 0.3085677581282e19 / 0.300468352592198e16  # unit_l / unit_t in the header
    speed = np.sqrt(sum(volume.array(f"velocity_{c}") ** 2 for c in "xyz")) / velocity_unit
    ionised, mass = volume.array("hydro_scalar_00"), density * cells
    fast = speed > 600
    sums = [mass.sum(), (mass * ionised).sum(), (cells * ionised).sum(), mass[fast].sum()]
    sums += [(mass * speed)[fast].sum(), 0.5 * (mass * speed**2)[fast].sum()]
    expected = [3648.8424659589, 15.943657592678, 1.25119193719e-3]
    expected += [85.258195308724, 80009.389236728, 41559668.822444]
    np.testing.assert_allclose(sums, expected, rtol=1e-9)  # rounding of sums over 1e5 cells


ENZO = "enzo_minihalo/moving7_0010"


@pytest.mark.exhaustive
def test_an_enzo_output():
    path = real(ENZO)
    volume = vm.open(path)
    assert volume.grid.cells_per_level == (3766, 1640, 7000, 7488, 3880, 1603, 900, 800)
    compared(volume, path, ["density", "temperature", "velocity_x"])
    assert volume.meta["redshift"] == pytest.approx(9.99102779566)
    # The root grid holds averages of finer ones: its mean is that of all.
    with h5py.File(path.with_name("moving7_0010.cpu0000")) as file:
        mean = file["Grid00000001/Density"][()].astype(float).mean()
        unit = volume.array("density").max() / max(file[g]["Density"][()].max() for g in file)
    mass = (volume.array("density") * volume.grid.cell_volumes).sum()
    assert mass / volume.grid.cell_volumes.sum() == pytest.approx(mean * unit, rel=1e-5)
