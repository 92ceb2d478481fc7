"""Totals on the command line: the same numbers as in Python, shown and written with units."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable

import voluminous as vm
from voluminous.cli import main
from voluminous.regions import DoubleCone, Sphere

MOMENTUM = "density * los('velocity')"


@pytest.fixture(autouse=True)
def gas(tmp_path, monkeypatch):
    """Gas in an HDF5 file, and a scene of it, in an empty working directory."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    volume = vm.Volume(vm.CartesianGrid.uniform((4, 5, 6), (-1, 1), unit="pc"))
    volume["temperature"] = rng.lognormal(5, 2, (4, 5, 6)) * u.K
    volume["density"] = (rng.random((4, 5, 6)) + 0.1) * u.g / u.cm**3
    for axis in "xyz":
        volume[f"velocity_{axis}"] = rng.normal(size=(4, 5, 6)) * u.km / u.s
    volume.save("gas.h5")
    medium = [{"type": "coefficients", "emissivity": "density / 1e20", "extinction": "0"}]
    camera = {"incl": 60.0, "phi": 30.0, "resolution": 8}
    vm.Scene({"volume": {"path": "gas.h5"}, "medium": medium, "camera": camera}).save("gas.toml")
    return volume


def told(capsys, *arguments):
    """Return what the command says; it must succeed."""
    assert main(["measure", *arguments]) == 0
    return capsys.readouterr().out


def test_the_mass_is_measured_by_default(gas, capsys):
    names, units, _, row = told(capsys, "gas.h5", "--unit", "density=Msun").splitlines()
    mass = vm.measure(gas, "density")["density"]
    assert names.split() == ["density", "volume", "cells"]
    assert units.split() == ["solMass", "pc3"]
    assert float(row.split()[0]) == pytest.approx(mass.to_value("Msun"), rel=1e-7)  # 8 digits
    assert row.split()[1:] == ["8", "120"]


def test_angles_conditions_and_tables(gas, capsys):
    asked = ["--quantity", f"p={MOMENTUM}", "--quantity", "0.5 * density == 1"]
    where = "los('velocity') > 500 m/s and density < 900 kg/m3"
    views = ["--angles", "0,0", "60,30", "--angles=-30,1e1"]
    out = told(capsys, "gas.h5", *asked, "--where", where, *views, "-o", "table.ecsv")
    assert "g km / s" in out
    assert out.splitlines()[-1] == "table.ecsv: 3 rows"
    table = QTable.read("table.ecsv")
    cameras = [vm.Orthographic(*angles) for angles in ((0, 0), (60, 30), (-30, 10))]
    expected = vm.measure(gas, {"p": MOMENTUM}, where, cameras)
    assert table.colnames == ["incl", "phi", "p", "0.5 * density == 1", "volume", "cells"]
    for name in ("incl", "phi", "p", "volume"):
        assert u.allclose(table[name], expected[name], rtol=1e-12)
    assert list(table["cells"]) == list(expected["cells"])


def test_a_scene_is_seen_by_its_camera(gas, capsys):
    told(
        capsys, "gas.toml", "--quantity", f"p={MOMENTUM}", "--set", "camera.incl=20", "-o", "b.fits"
    )
    (row,) = QTable.read("b.fits")
    momentum = vm.measure(gas, {"p": MOMENTUM}, camera=vm.Orthographic(20, 30))["p"]
    assert row["incl"] == 20 * u.deg
    assert u.isclose(row["p"], momentum, rtol=1e-12)


def test_a_region_is_that_of_python(gas, capsys):
    text = "doublecone((0, 0, 0), (0, 0, 1), 40 deg, 0.8 pc, side=up) & ~sphere((0,0,0), 4e4 AU)"
    told(capsys, "gas.h5", "--clip", text, "--where", "temperature > 50", "-o", "cone.ecsv")
    cone = DoubleCone((0, 0, 0), (0, 0, 1), 40, 0.8 * u.pc, side="up")
    core = Sphere((0, 0, 0), 4e4 * u.AU)
    expected = vm.measure(gas, "density", "temperature > 50", clip=cone & ~core)
    (row,) = QTable.read("cone.ecsv")
    assert 0 < row["cells"] == expected.cells < 120
    assert u.isclose(row["density"], expected["density"], rtol=1e-12)
    assert u.isclose(row["volume"], expected.volume, rtol=1e-12)


def test_an_aperture_fills_the_frame(gas, capsys):
    """A rectangle cuts no pixels then, and is exact: as exact columns of any pixels in it are."""
    text = "rectangle((-0.3, -1) pc, (0.4, 0.5) pc)"
    views = ["--angles", "0,0", "50,30"]
    told(capsys, "gas.h5", "--aperture", text, *views, "-o", "slit.ecsv")
    table = QTable.read("slit.ecsv")
    for row, angles in zip(table, ((0, 0), (50, 30)), strict=True):
        camera = vm.Orthographic(*angles, width=(0.7, 1.5), shift=(0.05, -0.25), resolution=7)
        column = vm.column(gas, "density", camera, method="exact", unit="g / pc2")
        total = column.intensity.sum() * column.pixel_area
        assert row["density"].to_value("g") == pytest.approx(total, rel=1e-10)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--quantity", f"p={MOMENTUM}"], "give --angles INCL,PHI"),
        (["--quantity", "a=density", "--quantity", "a=density"], "names 'a' twice"),
        (["--quantity", "mass=densty"], "did you mean 'density'"),
        (["--angles", "60"], "--angles expects INCL,PHI"),
        (["--unit", "density=km"], "density is in g, not km"),
        (["--unit", "Msun"], "--unit expects"),
        (["-o", "table.txt"], ".ecsv, .csv, .fits"),
        (["--where", "density > 5 km"], "5 km"),
        (["--clip", "sphre((0, 0, 0), 1)"], "did you mean 'sphere'"),
        (["--clip", "sphere((0, 0, 0), 1 s)"], "radius is in s, expected pc"),
        (["--aperture", "circle((0, 0), 1)"], "give --angles INCL,PHI"),
        (["--aperture", "polygon((0, 0), (1, 0), (2, 0))", "--angles", "0,0"], "has no area"),
    ],
)
def test_what_cannot_be_measured(arguments, words, capsys):
    assert main(["measure", "gas.h5", *arguments]) == 2
    assert words in capsys.readouterr().err
