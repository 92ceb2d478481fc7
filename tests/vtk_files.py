"""Data sets of VTK with known values, and files of them by VTK's own writers."""

import itertools

import numpy as np
import pytest

pytest.importorskip("vtkmodules", reason="VTK's own writers make the files")

from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonDataModel import vtkImageData, vtkRectilinearGrid
from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

POINTS = (4, 3, 5)
CELLS = (3, 2, 4)
LINES = ([0.0, 1.0, 3.0, 3.5], [-2.0, 0.0, 1.0], [5.0, 6.0, 6.25, 8.0, 9.0])
TYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")


def random_values(dtype, shape=POINTS, seed=0):
    """Return values all over the range of a type, indexed [ix, iy, iz]."""
    rng = np.random.default_rng(seed)
    if np.dtype(dtype).kind == "f":
        return rng.normal(size=shape).astype(dtype)
    limits = np.iinfo(dtype)
    return rng.integers(limits.min, limits.max, shape, dtype=dtype, endpoint=True)


def add(dataset, name, values, *, cells=False):
    """Add an array [ix, iy, iz] or [ix, iy, iz, component]; return VTK's."""
    flat = values.transpose(2, 1, 0, *range(3, values.ndim)).reshape(-1, *values.shape[3:])
    array = numpy_to_vtk(np.ascontiguousarray(flat), deep=True)
    array.SetName(name)
    (dataset.GetCellData() if cells else dataset.GetPointData()).AddArray(array)
    return array


def image(points=POINTS, origin=(0, 0, 0), spacing=(1, 1, 1), low=(0, 0, 0)):
    """Return image data whose first point has the index `low`."""
    data = vtkImageData()
    data.SetExtent(*itertools.chain(*((a, a + n - 1) for a, n in zip(low, points, strict=True))))
    data.SetOrigin(origin)
    data.SetSpacing(spacing)
    return data


def rectilinear(lines=LINES):
    """Return a rectilinear grid."""
    data = vtkRectilinearGrid()
    data.SetDimensions([len(line) for line in lines])
    for axis, line in zip("XYZ", lines, strict=True):
        getattr(data, f"Set{axis}Coordinates")(numpy_to_vtk(np.array(line), deep=True))
    return data


def write(writer, data, path, **settings):
    """Write with one of VTK's writers: ``SetX(value)`` for each setting ``X=value``."""
    writer.SetInputData(data)
    writer.SetFileName(str(path))
    for name, value in settings.items():
        getattr(writer, f"Set{name}")(value)
    assert writer.Write()
    return path


def write_image(data, path, **settings):
    """Write image data as XML."""
    return write(vtkXMLImageDataWriter(), data, path, **settings)


def point_centers(volume):
    """Return the centres of the cells, shape (cells, 3), in the fields' order."""
    return np.stack(volume.grid.cell_centers(0, volume.grid.size), axis=-1)
