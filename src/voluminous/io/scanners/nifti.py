"""NIfTI-1 and NIfTI-2 (.nii, .nii.gz, .hdr with .img): what brain imaging uses."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from .nifti_head import FIRST, is_head, placement_of, read_head, sizes_of
from .stored import GZIP, PLAIN, Stored
from .voxels import COLORS, VECTOR, VoxelReader, Voxels, components, time_step
from .written import lattice, single_field, slabs

if TYPE_CHECKING:
    from ...volume import Volume

_GZIP_MAGIC = b"\x1f\x8b"
_TYPES = {
    2: "u1",
    4: "i2",
    8: "i4",
    16: "f4",
    64: "f8",
    256: "i1",
    512: "u2",
    768: "u4",
    1024: "i8",
    1280: "u8",
}
# Bytes of red, green and blue (and opacity) side by side.
_COLORED = {128: 3, 2304: 4}
_VECTORS = (1006, 1007)  # intents: displacements, and vectors
_GAP = 4
_HEAD_AND_GAP = FIRST.itemsize + _GAP
_LARGEST_SIZE = 32767
_IN_MM, _SCANNER = 2, 1


class NIfTIReader(VoxelReader):
    """A NIfTI image: three dimensions, perhaps with time and components."""

    name = "nifti"
    description = "a NIfTI image (.nii, .nii.gz)"
    suffixes = (".nii", ".nii.gz", ".hdr", ".img")
    write_suffixes = (".nii", ".nii.gz")
    options = {  # noqa: RUF012 - as in Reader
        **VoxelReader.options,
        "time": "number of the time step, from 0, of a file with several",
    }
    writes = True

    def matches(self, path: Path, head: bytes) -> bool:
        """Return True for a head of either version, packed or not, or for data beside one."""
        return is_head(_plain_start(head)) or (_is_data(path) and _has_head(path))

    def voxels(self, path: Path, *, time: int = 0) -> Voxels:
        """Return what the head tells."""
        head_path, data_path = _pair(path)
        head = read_head(head_path)
        shape, times, count = sizes_of(head)
        dtype, colors = _dtype(head)
        size = int(np.prod(shape, dtype=object)) * colors
        stored = _stored(data_path, head, dtype, size * times * count).check()
        step = time_step(time, times)
        slope, intercept = _scaling(head)

        def load(number: int) -> np.ndarray:
            part, color = divmod(number, colors)
            block = stored.read((part * times + step) * size, (*shape[::-1], colors))
            return _scaled(block[..., color].transpose(), slope, intercept)

        vector = VECTOR if count == 3 and head["intent_code"] in _VECTORS else ()
        scaled = _scaled(np.zeros(1, dtype.newbyteorder("=")), slope, intercept)
        return Voxels(
            shape=shape,
            dtype=scaled.dtype,
            placement=placement_of(head),
            load=load,
            components=("",)
            if count * colors == 1
            else components(count * colors, COLORS if count == 1 else vector),
            meta={} if times == 1 else {"times": times, "time_step": step},
        )

    def write(self, volume: Volume, path: Path) -> None:
        """Write one field of a uniform Cartesian volume as NIfTI-1; packed if named ``.gz``."""
        values = volume.array(single_field(volume, "a NIfTI image"))
        if not path.name.lower().endswith((".nii", ".gz")):
            raise InputError(f"give a name that ends with .nii or .nii.gz, got {path.suffix!r}")
        head = _head_of(volume, values).tobytes()
        with _written(path) as file:
            file.write(head.ljust(_HEAD_AND_GAP, b"\0"))
            for slab in slabs(values):
                file.write(slab)


def _plain_start(head: bytes) -> bytes:
    """Return the first bytes as they are when unpacked."""
    if not head.startswith(_GZIP_MAGIC):
        return head
    try:
        return zlib.decompressobj(wbits=31).decompress(head, _HEAD_AND_GAP)
    except zlib.error:
        return b""


def _is_data(path: Path) -> bool:
    return path.name.lower().endswith((".img", ".img.gz"))


def _beside(path: Path, ending: str) -> Path | None:
    """Return the other file of a pair, which may be packed and in capitals or not."""
    base = path.with_suffix("") if path.suffix.lower() == ".gz" else path
    for suffix in (ending, f"{ending}.gz", ending.upper()):
        if (other := base.with_suffix("").with_name(base.stem + suffix)).is_file():
            return other
    return None


def _has_head(path: Path) -> bool:
    head = _beside(path, ".hdr")
    if head is None:
        return False
    try:
        with open(head, "rb") as file:
            return is_head(_plain_start(file.read(_HEAD_AND_GAP)))
    except OSError:
        return False


def _pair(path: Path) -> tuple[Path, Path]:
    """Return the files of the head and of the data: often one."""
    if _is_data(path):
        head = _beside(path, ".hdr")
        if head is None:
            raise FileFormatError(f"{path.name} holds data only; its head, a .hdr file, is missing")
        return head, path
    if not path.name.lower().endswith((".hdr", ".hdr.gz")):
        return path, path
    data = _beside(path, ".img")
    if data is None:
        raise FileFormatError(f"{path.name} is a head only; its data, an .img file, are missing")
    return path, data


def _dtype(head: Any) -> tuple[np.dtype[Any], int]:
    """Return the type of the numbers in the file, and how many make one voxel."""
    code = int(head["datatype"])
    if code not in _TYPES and code not in _COLORED:
        raise FileFormatError(
            f"datatype {code} is not known: expected one of {(*_TYPES, *_COLORED)} (real numbers "
            "of up to 64 bits, or colours)"
        )
    order = head.dtype["sizeof_hdr"].byteorder
    return np.dtype(_TYPES.get(code, "u1")).newbyteorder(order), _COLORED.get(code, 1)


def _stored(path: Path, head: Any, dtype: np.dtype[Any], count: int) -> Stored:
    offset = float(head["vox_offset"])
    if not 0 <= offset < 2**53:
        raise FileFormatError(f"vox_offset must be a number of bytes, got {offset}")
    if offset < head.itemsize and head["magic"].startswith(b"n+"):
        offset = head.itemsize + _GAP  # some leave it out: data cannot lie in the head
    with open(path, "rb") as file:
        packing = GZIP if file.read(2) == _GZIP_MAGIC else PLAIN
    return Stored((path,), dtype, count, packing, skipped=int(offset))


def _scaling(head: Any) -> tuple[float, float]:
    """Return slope and intercept; a slope of zero, or one that is no number, means none."""
    slope, intercept = float(head["scl_slope"]), float(head["scl_inter"])
    sound = np.isfinite(slope) and np.isfinite(intercept) and slope != 0
    return (slope, intercept) if sound else (1.0, 0.0)


def _scaled(values: np.ndarray, slope: float, intercept: float) -> np.ndarray:
    """Return true values: the stored ones where nothing is done to them."""
    if (slope, intercept) == (1.0, 0.0):
        return values
    kind = np.float64 if values.dtype == np.float64 else np.float32
    return values.astype(kind) * kind(slope) + kind(intercept)


def _head_of(volume: Volume, values: np.ndarray) -> np.ndarray:
    if max(values.shape) > _LARGEST_SIZE:
        raise InputError(
            f"NIfTI-1 holds up to {_LARGEST_SIZE} voxels along an axis, got {values.shape}"
        )
    placed = lattice(volume, "mm")
    dtype = np.dtype(np.uint8) if values.dtype == np.bool_ else values.dtype
    head = np.zeros((), FIRST.newbyteorder("<"))
    head["sizeof_hdr"], head["magic"] = FIRST.itemsize, b"n+1\0"
    head["dim"] = (3, *values.shape, 1, 1, 1, 1)
    head["datatype"] = {np.dtype(code): key for key, code in _TYPES.items()}[dtype]
    head["bitpix"] = 8 * dtype.itemsize
    head["pixdim"] = (1, *placed.widths, 0, 0, 0, 0)
    head["vox_offset"], head["scl_slope"] = _HEAD_AND_GAP, 1
    head["xyzt_units"], head["sform_code"] = _IN_MM, _SCANNER
    to_ras = np.array([-1.0, -1.0, 1.0])
    head["srow"] = np.column_stack([(placed.steps * to_ras).T, placed.origin * to_ras])
    return head


def _written(path: Path) -> IO[bytes]:
    if path.suffix.lower() == ".gz":
        return gzip.open(path, "wb")  # type: ignore[return-value]
    return open(path, "wb")
