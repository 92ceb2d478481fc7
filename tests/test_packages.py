"""Optional packages: what is said of those that are missing."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import voluminous as vm
from voluminous.io.guard import placed
from voluminous.packages import require


def test_what_is_not_there_is_told_without_a_traceback_of_the_import():
    with pytest.raises(
        vm.errors.MissingPackageError, match=r'pip install "voluminous\[all\]"'
    ) as found:
        require("nowhere_to_be_found.inside", "all", "nothing")
    assert found.value.__suppress_context__


@pytest.mark.parametrize(("module", "suffix"), [("OpenEXR", "exr"), ("tifffile", "tif")])
def test_image_formats_name_the_extra_that_they_need(module, suffix, tmp_path, monkeypatch):
    image = vm.Image(np.ones((2, 2, 1)))
    image.save(path := tmp_path / f"image.{suffix}")
    monkeypatch.setitem(sys.modules, module, None)  # as if it were not installed
    extra = {"exr": "exr", "tif": "tiff"}[suffix]
    for call in (vm.Image.load, image.save):
        with pytest.raises(vm.errors.MissingPackageError, match=rf"voluminous\[{extra}\]"):
            call(path)


def test_what_is_broken_is_told_with_its_traceback(tmp_path, monkeypatch):
    (tmp_path / "broken_package.py").write_text("import nowhere_to_be_found\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(vm.errors.MissingPackageError, match="nowhere_to_be_found") as found:
        require("broken_package", "all", "nothing")
    assert isinstance(found.value.__cause__, ModuleNotFoundError)
    assert "broken_package" not in sys.modules


def test_a_place_is_added_without_a_traceback_of_its_own():
    with pytest.raises(vm.InputError, match="here: wrong") as found, placed("here"):
        raise vm.InputError("wrong")
    assert found.value.__suppress_context__
    assert found.value.__cause__ is None
    with pytest.raises(vm.InputError, match="here: wrong") as found, placed("here"):
        raise vm.InputError("wrong") from KeyError("library")
    assert isinstance(found.value.__cause__, KeyError)
