"""NIfTI-1 and NIfTI-2 (.nii, .nii.gz, .hdr with .img), and Analyze 7.5, from which they come.

nibabel reads the header, this package the numbers: no more of them than are used.
"""

from __future__ import annotations

import gzip
import math
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...packages import require
from ..guard import by_library
from ..payload import checked_shape, unpacked
from .placement import Placement, lattice, single_field
from .stored import GZIP, PLAIN, StoredNumbers, unpacked_start
from .voxels import COLORS, VECTOR, VoxelReader, Voxels, component_names, time_step, times_meta

if TYPE_CHECKING:
    from ...volume import Volume

# Bytes of a header.
_FIRST, _SECOND = 348, 540
_NIFTI2, _ANALYZE = "nifti2.Nifti2PairHeader", "spm2analyze.Spm2AnalyzeHeader"
# Offset and values of the magic words of each version; Analyze has none.
_MAGICS = {
    "nifti1.Nifti1PairHeader": (344, b"n+1\0", b"ni1\0"),
    _NIFTI2: (4, b"n+2\0\r\n\x1a\n", b"ni2\0\r\n\x1a\n"),
}
# Bits of a voxel by the code of its type, which must agree in a header without a magic word.
_BITS = {2: 8, 4: 16, 8: 32, 16: 32, 64: 64, 128: 24, 130: 8, 132: 16, 136: 32}
_SINGLE = {b"n+1": _FIRST + 4, b"n+2": _SECOND + 4}
_VECTORS = (1006, 1007)  # intents: displacements, and vectors
_UNITS = {1: "m", 2: "mm", 3: "um"}
_LARGEST_SIZE = 32767


class NIfTIReader(VoxelReader):
    """An image of three dimensions, perhaps with time and components."""

    name = "nifti"
    description = "a NIfTI or Analyze image (.nii, .nii.gz, .hdr with .img)"
    suffixes = (".nii", ".nii.gz", ".hdr", ".img")
    write_suffixes = (".nii", ".nii.gz")
    packages = ("nibabel",)
    extra = "medical"
    options = {  # noqa: RUF012 - as in Reader
        **VoxelReader.options,
        "time": "number of the time step, from 0, of a file with several",
    }
    writes = True

    def matches(self, path: Path, head: bytes) -> bool:
        if _kind(unpacked_start(head, _SECOND)):
            return True
        header = _beside(path, ".hdr") if _is_data(path) else None
        try:
            return header is not None and bool(_kind(_start(header)))
        except (OSError, EOFError, zlib.error):
            return False

    def voxels(self, path: Path, *, time: int = 0) -> Voxels:
        header_path, data_path = _pair(path)
        header = _read_header(header_path)
        with by_library("nibabel"):
            shape, times, count = _sizes(header)
            dtype, placement = header.get_data_dtype(), _placement(header)
            slope, intercept = header.get_slope_inter()
            slope, intercept = (1.0, 0.0) if slope is None else (slope, intercept or 0.0)
        colors = len(dtype.names or (0,))
        dtype = np.dtype(np.uint8) if colors > 1 else dtype
        if dtype.kind not in "iuf" or dtype.itemsize > 8:
            raise FileFormatError(
                "expected real numbers of up to 64 bits, got "
                f"datatype {header['datatype']}: {dtype}"
            )
        size = math.prod(shape) * colors
        stored = _stored(data_path, header, dtype, size * times * count).check()
        step = time_step(time, times)

        def load(number: int) -> np.ndarray:
            part, color = divmod(number, colors)
            block = stored.read((part * times + step) * size, (*shape[::-1], colors))
            return _scaled(block[..., color].transpose(), slope, intercept)

        vector = VECTOR if count == 3 and _code(header, "intent_code") in _VECTORS else ()
        return Voxels(
            shape=shape,
            dtype=_scaled(np.zeros(1, dtype.newbyteorder("=")), slope, intercept).dtype,
            placement=placement,
            load=load,
            components=component_names(count * colors, COLORS if count == 1 else vector),
            meta=times_meta(times, step),
        )

    def write(self, volume: Volume, path: Path) -> None:
        values = volume.array(single_field(volume, "a NIfTI image"))
        if not path.name.lower().endswith((".nii", ".gz")):
            raise InputError(f"give a name that ends with .nii or .nii.gz, got {path.suffix!r}")
        if max(values.shape) > _LARGEST_SIZE:
            raise InputError(
                f"NIfTI-1 holds up to {_LARGEST_SIZE} voxels along an axis, got {values.shape}"
            )
        nibabel = require("nibabel", "medical", "writing NIfTI")
        placed = lattice(volume, "mm")
        affine = np.eye(4)
        affine[:3] = np.column_stack([placed.steps.T, placed.origin])
        values = values.view(np.uint8) if values.dtype == np.bool_ else values
        image = nibabel.Nifti1Image(values, np.diag([-1, -1, 1, 1]) @ affine, dtype=values.dtype)
        image.set_sform(image.affine, code="scanner")
        image.set_qform(None, code="unknown")
        image.header.set_xyzt_units("mm")
        with (gzip.open if path.suffix.lower() == ".gz" else open)(path, "wb") as file:
            image.to_stream(file)


def _kind(start: bytes) -> str:
    """Return nibabel's class for a header that starts so; the empty string for none."""
    for kind, (at, *words) in _MAGICS.items():
        if start[at:].startswith(tuple(words)):
            return kind
    if len(start) < _FIRST:
        return ""
    for order in ("<", ">"):
        size, dimensions, code, bits = (
            np.frombuffer(start, f"{order}{kind}", 1, at)[0]
            for kind, at in (("i4", 0), ("i2", 40), ("i2", 70), ("i2", 72))
        )
        if size == _FIRST and 1 <= dimensions <= 7 and _BITS.get(int(code)) == bits:
            return _ANALYZE
    return ""


def _is_data(path: Path) -> bool:
    return path.name.lower().endswith((".img", ".img.gz"))


def _beside(path: Path, ending: str) -> Path | None:
    """Return the other file of a pair, which may be packed and in capitals or not."""
    base = path.with_suffix("") if path.suffix.lower() == ".gz" else path
    for suffix in (ending, f"{ending}.gz", ending.upper()):
        if (other := base.with_suffix("").with_name(base.stem + suffix)).is_file():
            return other
    return None


def _start(path: Path) -> bytes:
    with unpacked(path) as file:
        return file.read(_SECOND)


def _pair(path: Path) -> tuple[Path, Path]:
    """Return the files of the header and of the data, which may be one."""
    if not path.name.lower().endswith((".hdr", ".hdr.gz", ".img", ".img.gz")):
        return path, path
    other = _beside(path, ".hdr" if _is_data(path) else ".img")
    if other is None:
        raise FileFormatError(
            f"{path.name} holds data only; its header, a .hdr file, is missing"
            if _is_data(path)
            else f"{path.name} is a header only; its data, an .img file, are missing"
        )
    return (other, path) if _is_data(path) else (path, other)


def _read_header(path: Path) -> Any:
    with by_library("gzip"):
        start = _start(path)
    kind = _kind(start)
    size = _SECOND if kind == _NIFTI2 else _FIRST
    if kind and len(start) >= size:
        module, _, name = kind.partition(".")
        library = require(f"nibabel.{module}", "medical", "reading NIfTI")
        header = getattr(library, name)(start[:size], check=False)
        if header["sizeof_hdr"] == size:
            return header
    raise FileFormatError(
        f"expected the header of NIfTI-1 or Analyze ({_FIRST} bytes) or NIfTI-2 ({_SECOND} bytes), "
        "but it is damaged or cut short"
    )


def _sizes(header: Any) -> tuple[tuple[int, ...], int, int]:
    """Return the shape, and the numbers of times and of components."""
    shape = header.get_data_shape()
    if not 2 <= header["dim"][0] <= 7:
        raise FileFormatError(f"dim[0] must be from 2 to 7, got {header['dim'][0]}")
    sizes = checked_shape(shape, "dim") + (1,) * (7 - len(shape))
    if math.prod(sizes[5:]) > 1:
        raise FileFormatError(f"expected x, y, z, time and components at most, got dim {sizes}")
    return sizes[:3], sizes[3], sizes[4]


def _code(header: Any, name: str) -> int:
    return int(header[name]) if name in header else 0


def _placement(header: Any) -> Placement:
    """Return where the voxels are: by the sform, else the qform, else their widths alone."""
    unit = _UNITS.get(_code(header, "xyzt_units") & 7, "mm")
    if _code(header, "sform_code") > 0:
        affine = header.get_sform()
    elif _code(header, "qform_code") > 0:
        affine = header.get_qform()
    else:  # also Analyze, in which left and right are a matter of belief
        return Placement(np.zeros(3), np.diag(np.array(header["pixdim"][1:4], float)), unit)
    return Placement(affine[:3, 3], affine[:3, :3].T, unit, "RAS")


def _stored(path: Path, header: Any, dtype: np.dtype[Any], count: int) -> StoredNumbers:
    offset = float(header["vox_offset"])
    if not 0 <= offset < 2**53:
        raise FileFormatError(f"vox_offset must be a number of bytes, got {offset}")
    # Some leave it out: data cannot lie in the header.
    magic = bytes(header["magic"])[:3] if "magic" in header else b""
    offset = max(offset, _SINGLE.get(magic, 0))
    with open(path, "rb") as file:
        packing = GZIP if file.read(2) == b"\x1f\x8b" else PLAIN
    return StoredNumbers((path,), dtype, count, packing, skipped=int(offset))


def _scaled(values: np.ndarray, slope: float, intercept: float) -> np.ndarray:
    if (slope, intercept) == (1.0, 0.0):
        return values
    kind = np.float64 if values.dtype == np.float64 else np.float32
    return values.astype(kind) * kind(slope) + kind(intercept)
