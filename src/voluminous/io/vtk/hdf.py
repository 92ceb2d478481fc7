"""VTK's data in HDF5 (.vtkhdf): image data.

https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...errors import InputError
from ..hdf5 import check_places, is_hdf5, opened, text
from .dataset import ADVICE, Dataset, DatasetReader
from .objects import dataset_of, lazy_dataset, updated

_ROOT = "VTKHDF"


class VTKHDFReader(DatasetReader):
    """Image data of one time in an HDF5 file of VTK."""

    name = "vtkhdf"
    description = "an HDF5 file of VTK with image data (.vtkhdf)"
    suffixes = (".vtkhdf",)
    packages = ("vtkmodules",)
    extra = "vtk"

    def matches(self, path: Path, head: bytes) -> bool:
        if not is_hdf5(head):
            return False
        try:
            with opened(path) as file:
                return "Type" in file[_ROOT].attrs
        except Exception:  # damaged, or another: whoever reads it says so
            return path.suffix.lower() in self.suffixes

    def dataset(self, path: Path, *, resolution: Any = None, **options: Any) -> Dataset:
        check_places(path)
        if resolution is not None:
            return dataset_of(updated("IOHDF", "HDFReader", path), resolution)
        with opened(path) as file:
            kind, is_series = text(file[_ROOT].attrs.get("Type")), "Steps" in file[_ROOT]
        if kind != "ImageData":
            raise InputError(f"it holds {kind[:100]}, not a regular grid{ADVICE}")
        if is_series:
            raise InputError("it is a series of times; save one of them as .vti, or as .vtkhdf")
        return lazy_dataset("IOHDF", "HDFReader", path)
