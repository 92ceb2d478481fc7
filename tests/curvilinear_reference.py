"""The spherical models among the reference images (see `reference`)."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import pytest

import voluminous as vm
from reference import Case, Model, data_directory, model_of, stored_in

SPHERICAL = ("spher3d", "spher2d")


@dataclass(frozen=True)
class SphericalModel:
    """A model, its grid, and its images."""

    model: Model
    grid: vm.SphericalGrid
    cases: dict[str, Case]


def why_absent() -> str:
    """Say why there are no reference images; the empty string if there are."""
    directory = data_directory() / "radmc3d"
    if all((directory / f"{name}.npz").is_file() for name in SPHERICAL):
        return ""
    return f"no spherical RADMC-3D images in {directory}; set VOLUMINOUS_TEST_DATA"


@functools.lru_cache
def load_spherical(name: str) -> SphericalModel:
    """Load one spherical model."""
    stored, meta = stored_in(data_directory() / "radmc3d" / f"{name}.npz")
    model = model_of(stored, meta, {"n": stored["n"].astype(np.float64)})
    return SphericalModel(model, vm.SphericalGrid(*model.edges, unit="cm"), model.cases)


def spherical_cases(chosen) -> list:
    """Return one ``pytest.param(model, case)`` for every image that `chosen` accepts."""
    if reason := why_absent():
        return [pytest.param("", "", marks=pytest.mark.skip(reason=reason), id="no data")]
    return [
        pytest.param(name, case.id, id=f"{name}-{case.id}")
        for name in SPHERICAL
        for case in load_spherical(name).cases.values()
        if case.quantity != "tausurf" and not case.camera["fluxcons"] and chosen(case)
    ]
