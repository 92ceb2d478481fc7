"""Reference models as directories of RADMC-3D: read bit for bit, and drawn as RADMC-3D does."""

from __future__ import annotations

import pytest

import reference
import voluminous as vm
from radmc3d_directory import put_field, put_grid
from radmc3d_models import same


@pytest.mark.parametrize("name", reference.CARTESIAN)
def test_reference_models(tmp_path, name):
    model = reference.load_model(name)
    encoding = "binary" if name == "core" else "text"  # a million numbers
    put_grid(tmp_path, model.edges, encoding=encoding)
    for field, array in model.fields.items():
        flat = array.transpose(2, 1, 0).ravel()
        put_field(tmp_path, field, flat, encoding=encoding)
    volume = vm.open(tmp_path)
    for found, expected in zip(volume.grid.edges, model.edges, strict=True):
        same(found, expected)
    assert set(volume.fields) == set(model.fields)
    for field, array in model.fields.items():
        same(volume.array(field), array)
