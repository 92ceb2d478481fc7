"""What nibabel reads: NIfTI, Analyze, MINC, MGH of FreeSurfer, AFNI and PAR/REC of Philips."""

from __future__ import annotations

import gzip
import math
import re
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...files import check_readable
from ...memory import check_memory
from ...packages import require
from ..guard import by_library
from ..hdf5 import check_places, holds
from ..payload import checked_shape
from .placement import Placement, lattice, single_field
from .voxels import (
    COLORS,
    TIMED,
    VECTOR,
    VoxelReader,
    Voxels,
    component_names,
    time_step,
    times_meta,
)

if TYPE_CHECKING:
    from ...volume import Volume

# Offsets and magic words of NIfTI-1 and NIfTI-2; the first number of an Analyze header is its size.
_MAGICS = ((344, (b"n+1\0", b"ni1\0")), (4, (b"n+2\0", b"ni2\0")))
_ANALYZE = ((348).to_bytes(4, "little"), (348).to_bytes(4, "big"))
_HEADER = 540
_VECTORS = (1006, 1007)  # intents: displacements, and vectors
_UNITS = {"meter": "m", "micron": "um"}
_LARGEST_SIZE = 32767
_PACKED = (".gz", ".mgz", ".bz2", ".z")


class NibabelReader(VoxelReader):
    """An image of three dimensions, perhaps with time and components."""

    packages = ("nibabel",)
    extra = "medical"
    options = TIMED
    kind = ""  # nibabel's class

    def voxels(self, path: Path, *, time: int = 0) -> Voxels:
        with by_library("nibabel"):
            image = self.image(path)
            for holder in image.file_map.values():
                check_readable(Path(holder.filename or path))
            sizes = checked_shape(image.shape)
            if math.prod(sizes[5:]) > 1:
                raise FileFormatError(f"expected x, y, z, time and components, got sizes {sizes}")
            axis = self.axis_of_time(image) if len(sizes) > 3 else 3
            dtype, colors = _value_type(path, image)
            placement, is_vector = self.placement(image), self.is_vector(image)
        times, count = (sizes[k] if len(sizes) > k else 1 for k in (axis, 4))
        step = time_step(time, times)
        shape = tuple(n for k, n in enumerate((*sizes, 1, 1)) if k != axis)[:3]

        def load(number: int) -> np.ndarray:
            part, color = divmod(number, colors)
            chosen = {axis: step, 4: part}
            check_memory(8 * math.prod(shape), f"reading {path.name}", "read a coarser copy")
            with by_library("nibabel"):
                index = tuple(chosen.get(k, slice(None)) for k in range(len(sizes)))
                values = self.image(path).dataobj[index]
                values = values[values.dtype.names[color]] if colors > 1 else values
                return np.asarray(values, dtype).reshape(shape)

        endings = COLORS if count == 1 else VECTOR if is_vector and count == 3 else ()
        return Voxels(
            shape=shape,
            dtype=dtype,
            placement=placement,
            load=load,
            components=component_names(count * colors, endings),
            meta=times_meta(times, step),
        )

    def image(self, path: Path) -> Any:
        """Return nibabel's image; values are not read, nor mapped."""
        nibabel = require("nibabel", self.extra, f"reading {self.description}")
        module, _, name = self.kind.rpartition(".")
        kind = getattr(require(f"nibabel.{module}", self.extra, "") if module else nibabel, name)
        if len(kind.files_types) > 1:
            return kind.from_filename(path, mmap=False)
        # The name of a single file need not have the usual ending.
        return kind.from_file_map({"image": nibabel.FileHolder(str(path))}, mmap=False)

    def axis_of_time(self, image: Any) -> int:
        """Return the axis that is not space."""
        return 3

    def placement(self, image: Any) -> Placement:
        """Return where the voxels are."""
        return Placement(image.affine[:3, 3], image.affine[:3, :3].T, "mm", "RAS")

    def is_vector(self, image: Any) -> bool:
        """Return True if the components are those of a vector."""
        return False


def _value_type(path: Path, image: Any) -> tuple[np.dtype[Any], int]:
    """Return the type of true values (real where they are scaled), and the number of colours.

    The last value is read for that, which reveals files that are cut short; of packed ones the
    first.
    """
    stored = np.dtype(image.get_data_dtype()).newbyteorder("=")
    if stored.names:
        return np.dtype(np.uint8), len(stored.names)
    if stored.kind not in "iuf" or stored.itemsize > 8:
        raise FileFormatError(f"expected real numbers of up to 64 bits, got {stored}")
    last = tuple(0 if path.suffix.lower() in _PACKED else n - 1 for n in image.shape)
    true = np.asarray(image.dataobj[last]).dtype.newbyteorder("=")
    return true if true == stored or stored.itemsize == 8 else np.dtype(np.float32), 1


class NIfTIReader(NibabelReader):
    """NIfTI-1 and NIfTI-2 in one file or two, and Analyze 7.5, from which they come."""

    name = "nifti"
    description = "a NIfTI or Analyze image (.nii, .nii.gz, .hdr with .img)"
    suffixes = (".nii", ".nii.gz", ".hdr", ".img")
    write_suffixes = (".nii", ".nii.gz")
    writes = True

    def matches(self, path: Path, head: bytes) -> bool:
        header = path.parent / re.sub(r"(?i)\.img(?=$|\.gz$)", ".hdr", path.name)
        if header != path and header.is_file():
            head = header.read_bytes()[:_HEADER]
        start = _unpacked_start(head, _HEADER)
        is_analyze = header.suffix.lower() == ".hdr" and start.startswith(_ANALYZE)
        return is_analyze or any(start[at:].startswith(words) for at, words in _MAGICS)

    def image(self, path: Path) -> Any:
        nibabel = require("nibabel", self.extra, f"reading {self.description}")
        if path.name.lower().endswith((*self.suffixes, ".hdr.gz", ".img.gz")):
            return nibabel.load(path, mmap=False)
        holder = {"image": nibabel.FileHolder(str(path))}
        with open(path, "rb") as file:
            second = file.read(8)[4:].startswith(_MAGICS[1][1])
        kind = nibabel.Nifti2Image if second else nibabel.Nifti1Image
        return kind.from_file_map(holder, mmap=False)

    def placement(self, image: Any) -> Placement:
        """Return where the voxels are: by the sform, else the qform, else their widths alone."""
        header = image.header
        if not hasattr(header, "get_sform"):  # Analyze: left and right are a matter of belief
            return Placement(np.zeros(3), np.diag((*header.get_zooms(), 1, 1)[:3]), "mm")
        unit = _UNITS.get(header.get_xyzt_units()[0], "mm")
        if header["sform_code"] <= 0 and header["qform_code"] <= 0:
            return Placement(np.zeros(3), np.diag(np.array(header["pixdim"][1:4], float)), unit)
        return Placement(image.affine[:3, 3], image.affine[:3, :3].T, unit, "RAS")

    def is_vector(self, image: Any) -> bool:
        return "intent_code" in image.header and int(image.header["intent_code"]) in _VECTORS

    def write(self, volume: Volume, path: Path) -> None:
        values = volume.array(single_field(volume, "a NIfTI image"))
        if not path.name.lower().endswith((".nii", ".gz")):
            raise InputError(f"give a name that ends with .nii or .nii.gz, got {path.suffix!r}")
        if max(values.shape) > _LARGEST_SIZE:
            raise InputError(
                f"NIfTI-1 holds up to {_LARGEST_SIZE} voxels along an axis, got {values.shape}"
            )
        nibabel = require("nibabel", "medical", "writing NIfTI")
        origin, steps = lattice(volume, "mm")
        affine = np.eye(4)
        affine[:3] = np.column_stack([steps.T, origin])
        values = values.view(np.uint8) if values.dtype == np.bool_ else values
        image = nibabel.Nifti1Image(values, np.diag([-1, -1, 1, 1]) @ affine, dtype=values.dtype)
        image.set_sform(image.affine, code="scanner")
        image.set_qform(None, code="unknown")
        image.header.set_xyzt_units("mm")
        with (gzip.open if path.suffix.lower() == ".gz" else open)(path, "wb") as file:
            image.to_stream(file)


class MINCReader(NibabelReader):
    """MINC 1 lies in NetCDF, MINC 2 in HDF5."""

    name = "minc"
    description = "a MINC image (.mnc)"
    suffixes = (".mnc",)

    def matches(self, path: Path, head: bytes) -> bool:
        if head.startswith(b"CDF\x01"):
            return all(word in head for word in (b"xspace", b"yspace", b"zspace"))
        return holds(path, head, lambda file: "minc-2.0" in file)

    def image(self, path: Path) -> Any:
        nibabel = require("nibabel", self.extra, f"reading {self.description}")
        with open(path, "rb") as file:
            kind = nibabel.Minc1Image if file.read(3) == b"CDF" else nibabel.Minc2Image
        check_places(path)
        return kind.from_file_map({"image": nibabel.FileHolder(str(path))}, mmap=False)

    def axis_of_time(self, image: Any) -> int:
        """Return the axis whose name is no direction of space."""
        names = image.dataobj.minc_file._dim_names
        return next(k for k, name in enumerate(names) if not name.endswith("space"))


class MGHReader(NibabelReader):
    """Big-endian numbers, perhaps packed by gzip."""

    name = "mgh"
    description = "a FreeSurfer image (.mgh, .mgz)"
    suffixes = (".mgh", ".mgz")
    kind = "MGHImage"

    def matches(self, path: Path, head: bytes) -> bool:
        is_first = _unpacked_start(head, 30).startswith(b"\0\0\0\1")  # version of the format
        return is_first and path.suffix.lower() in self.suffixes


class AFNIReader(NibabelReader):
    """A text header, and sub-bricks beside it, which are taken for time steps."""

    name = "afni"
    description = "an AFNI image (.HEAD with .BRIK)"
    suffixes = (".head", ".brik", ".brik.gz")
    kind = "brikhead.AFNIImage"

    def matches(self, path: Path, head: bytes) -> bool:
        if b"-attribute" in head[:100] and head.lstrip().startswith(b"type"):
            return True
        name, dot, _ = path.name.rpartition(".BRIK")
        return bool(dot) and path.with_name(f"{name}.HEAD").is_file()


class PARRECReader(NibabelReader):
    """A text header, and slices beside it."""

    name = "parrec"
    description = "a Philips image (.PAR with .REC)"
    suffixes = (".par", ".rec")
    kind = "parrec.PARRECImage"

    def matches(self, path: Path, head: bytes) -> bool:
        if b"DATA DESCRIPTION FILE" in head[:200]:
            return True
        pair = {".rec": ".par", ".REC": ".PAR"}.get(path.suffix)
        return pair is not None and path.with_suffix(pair).is_file()


def _unpacked_start(head: bytes, size: int) -> bytes:
    try:
        is_packed = head.startswith(b"\x1f\x8b")
        return zlib.decompressobj(wbits=31).decompress(head, size) if is_packed else head
    except zlib.error:
        return b""
