"""Totals of real snapshots are the sums over cells that came with them (their PROVENANCE.md)."""

from __future__ import annotations

import re

import numpy as np
import pytest

import voluminous as vm
from reference import data_directory

OUTFLOW = "athena_disc_outflow/DiskOutflow_t0.20.athdf"
IONISED = "ramses_hii_outflow/output_00003"
FAST = {
    "mass": "density",
    "momentum": "density * abs(los('velocity'))",
    "energy": "0.5 * density * norm('velocity')**2",
}


def opened(place):
    path = data_directory() / "data" / place
    if not path.exists():
        pytest.skip(f"no {path}; set VOLUMINOUS_TEST_DATA")
    return vm.open(path)


def test_an_outflow_from_a_disc():
    volume = opened(OUTFLOW)
    along = vm.Orthographic(20, 0, resolution=16)  # looks along the axis (0, -sin 20°, cos 20°)
    assert float(vm.measure(volume, "density")["density"]) == pytest.approx(376.93588, rel=3e-8)
    found = vm.measure(volume, FAST, "norm('velocity') > 8", along)
    # As many digits as are told.
    expected = {"mass": 0.734709, "momentum": 15.97194, "energy": 225.3725}
    for name, total in expected.items():
        assert float(found[name]) == pytest.approx(total, rel=1e-6)


def test_an_outflow_that_is_driven_by_ionisation():
    pytest.importorskip("yt")
    volume = opened(IONISED)
    text = (data_directory() / "data" / IONISED / "info_00003.txt").read_text()
    unit = {name: float(value) for name, value in re.findall(r"(unit_\w)\s*=\s*(\S+)", text)}
    mass, speed = unit["unit_d"] * unit["unit_l"] ** 3, unit["unit_l"] / unit["unit_t"]
    asked = {**FAST, "momentum": "density * norm('velocity')"}
    found = vm.measure(volume, asked, f"norm('velocity') > {600 * speed} cm/s", vm.Orthographic())
    own = [
        found["mass"].to_value("g") / mass,
        found["momentum"].to_value("g cm / s") / (mass * speed),
        found["energy"].to_value("erg") / (mass * speed**2),
    ]
    # The code's parsec and that of yt differ by 2e-10, and here it is cubed.
    np.testing.assert_allclose(own, [85.258195308724, 80009.389236728, 41559668.822444], rtol=2e-9)


@pytest.mark.parametrize("tolerance", [1e-3, None])
def test_a_thin_hii_region_is_as_bright_as_its_cells(tolerance):
    """Of interpolated densities and temperatures it is 12 % too faint.

    1 %: at jumps of level vertices do not weigh all cells alike, and pixels are two fine cells.
    """
    pytest.importorskip("yt")
    volume = opened(IONISED)
    volume["ions"] = "density / (1.67e-24 g) * clip(hydro_scalar_00, 0, 1)"
    volume["T"] = "pressure / density * (1.67e-24 g) / (1 + hydro_scalar_00) / (1.38e-16 erg/K)"
    gas = vm.FreeFree("ions", temperature="T")
    cells, found = (
        vm.spectrum(
            volume,
            gas,
            vm.Orthographic(60, 20, resolution=300),
            frequencies=1e11,
            distance="1 kpc",
            antialias="adaptive" if scheme else None,
            tolerance=tolerance,
            scheme=scheme,
        )
        for scheme in ("first-order", None)
    )
    assert cells.flux[0] == pytest.approx(11.35, rel=5e-3)
    assert found.flux == pytest.approx(cells.flux, rel=1e-2)
    assert "cells" not in found.provenance
