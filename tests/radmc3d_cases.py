"""Models with physics in RADMC-3D's own files, and the images and spectra it made of them.

`write_model` makes a model's folder of the arrays in ``radmc3d_physics/NAME.npz``; the files are
written as RADMC-3D's manual says, apart from the package (`radmc3d_directory`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radmc3d_directory import put_field, put_grid, put_species
from reference import data_directory, stored_in

MODELS = (
    "dust_cart",
    "dust_octree",
    "dust_spher2d",
    "dust_spher3d",
    "external",
    "extras_partition",
    "freefree",
    "line_cart",
    "line_octree",
    "line_spher3d",
    "spectra_cart",
    "spectra_spher2d",
    "star_table",
)
# Fields with one number in each cell.
_SCALARS = ("gas_temperature", "microturbulence", "electron_numdens", "ion_numdens")
_BINARY = {True: "binary", False: "text"}


def stored_model(name: str) -> tuple[dict, dict]:
    """Return the arrays of a model and what is said of them; skip where there is no data."""
    path = data_directory() / "radmc3d_physics" / f"{name}.npz"
    if not path.is_file():
        pytest.skip(f"no {path}; set VOLUMINOUS_TEST_DATA")
    return stored_in(path)


def case_of(meta: dict, name: str) -> dict:
    """Return the case of that id."""
    (case,) = [case for case in meta["cases"] if case["id"] == name]
    return case


def reference_of(stored: dict, case: dict) -> np.ndarray:
    """Return RADMC-3D's image (ny, nx, channel), or the fluxes of its spectrum at 1 pc."""
    if case["quantity"] == "spectrum":
        return stored[f"spec_{case['id']}"][:, 1]
    return stored[f"img_{case['id']}"]


def write_model(stored: dict, meta: dict, directory: Path, *, binary: bool = False) -> Path:
    """Write a model's folder, all but the files of a case; return it."""
    directory.mkdir(exist_ok=True)
    encoding = _BINARY[binary]
    put_grid(
        directory,
        [stored[f"edges_x{axis}"].astype(np.float64) for axis in (1, 2, 3)],
        coordinates=meta["coordsystem"],
        active=meta["active_dims"],
        flags=stored.get("octree_bits"),
        layers=stored.get("layers"),
        encoding=encoding,
    )
    for key, ending in (("dust_density", "inp"), ("dust_temperature", "dat")):
        if key in stored:
            species = stored[key].astype(np.float64)
            put_species(directory, key, *species, encoding=encoding, ending=ending)
    for key in _SCALARS:
        if key in stored:
            # RADMC-3D itself finds these two as text only.
            form = "text" if key.endswith("numdens") else encoding
            put_field(directory, key, stored[key].astype(np.float64), encoding=form)
    if "gas_velocity" in stored:
        columns = stored["gas_velocity"].astype(np.float64).T
        put_field(directory, "gas_velocity", *columns, encoding=encoding)
    _write_opacities(stored, directory)
    for molecule, density in zip(
        meta["molecules"] or (), stored.get("numberdens", ()), strict=True
    ):
        stem = f"numberdens_{molecule['name']}"
        put_field(directory, stem, density.astype(np.float64), encoding=encoding)
    _write_molecules(meta["molecules"] or (), directory)
    if "partition_T" in stored:
        rows = np.column_stack([stored["partition_T"], stored["partition_Z"]])
        name = meta["molecules"][0]["name"]
        _put(directory, f"partitionfunction_{name}.inp", 1, len(rows), rows)
    waves = np.array(meta["global_wavelength_micron"])
    _put(directory, "wavelength_micron.inp", len(waves), waves)
    if meta["stars"]:
        _write_stars(meta["stars"], waves, directory)
    if "external_intensity" in stored:
        _put(directory, "external_source.inp", 2, len(waves), waves, stored["external_intensity"])
    write_settings(meta, {}, directory)
    return directory


def write_settings(meta: dict, case: dict, directory: Path) -> None:
    """Write ``radmc3d.inp``, and the files that a case's words name."""
    given = [meta.get("settings") or "", case.get("settings") or "", "scattering_mode_max = 0"]
    (directory / "radmc3d.inp").write_text("\n".join(given) + "\n")
    words = case.get("arguments", "").split()
    if "loadlambda" in words:
        waves = case.get("wavelength_micron")
        if waves is None:  # of spectra there are frequencies
            waves = 2.99792458e14 / np.array(case["nu_hz"])
        _put(directory, "camera_wavelength_micron.inp", len(waves), np.array(waves))
    if "useapert" in words:
        rows = np.array([[0.1, 0.4], [20.0, 0.7], [3000.0, 1.2]])  # as README.md says
        _put(directory, "aperture_info.inp", 1, len(rows), rows)


def _put(directory: Path, name: str, *parts: object) -> None:
    """Write whole numbers, and the rows of arrays, each on a line of its own."""
    lines = []
    for part in parts:
        if isinstance(part, np.ndarray):
            lines += [" ".join(f"{x:.17e}" for x in np.atleast_1d(row)) for row in part]
        else:
            lines.append(str(part))
    (directory / name).write_text("\n".join(lines) + "\n")


def _write_opacities(stored: dict, directory: Path) -> None:
    tables = [stored[key] for key in ("kappa_0", "kappa_1") if key in stored]
    if not tables:
        return
    lines = ["2", str(len(tables)), "-" * 20]
    for number, table in enumerate(tables):
        lines += ["1", "0", f"grain{number}", "-" * 20]
        _put(directory, f"dustkappa_grain{number}.inp", 1, len(table), table)
    (directory / "dustopac.inp").write_text("\n".join(lines) + "\n")


def _write_molecules(molecules: list, directory: Path) -> None:
    if not molecules:
        return
    lines = ["2", str(len(molecules))]
    for molecule in molecules:
        name, levels = molecule["name"], molecule["levels_cm1_g"]
        lines.append(f"{name} leiden 0 0 0")
        text = ["!MOLECULE", name, "!WEIGHT", repr(molecule["weight"]), "!LEVELS", str(len(levels))]
        text.append("!LEVEL + ENERGY + WEIGHT + J")
        text += [f"{k + 1} {e!r} {g!r} {k}" for k, (e, g) in enumerate(levels)]
        transitions = molecule["transitions_up_low_A_GHz"]
        text += ["!LINES", str(len(transitions)), "!LINE + UP + LOW + A + GHZ + E"]
        kelvin = 1.4388  # for the column that no program reads
        text += [
            f"{k + 1} {up:.0f} {low:.0f} {a!r} {ghz!r} {kelvin * levels[int(up) - 1][0]:.3f}"
            for k, (up, low, a, ghz) in enumerate(transitions)
        ]
        text += ["!NUMBER OF COLLISION PARTNERS", "0"]
        (directory / f"molecule_{name}.inp").write_text("\n".join(text) + "\n")
    (directory / "lines.inp").write_text("\n".join(lines) + "\n")


def _write_stars(stars: list, waves: np.ndarray, directory: Path) -> None:
    bodies = np.array([[star["R"], 2e33, *star["pos"]] for star in stars])
    spectra = [np.array(star["flux_pc"] if "flux_pc" in star else [-star["T"]]) for star in stars]
    _put(directory, "stars.inp", 2, f"{len(stars)} {len(waves)}", bodies, waves, *spectra)
