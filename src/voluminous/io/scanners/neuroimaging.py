"""What nibabel reads besides NIfTI: MINC, MGH of FreeSurfer, AFNI and PAR/REC of Philips."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...memory import check_memory
from ...packages import require
from ..guard import by_library
from ..hdf5 import holds
from ..payload import checked_shape
from .placement import Placement
from .stored import unpacked_start
from .voxels import VoxelReader, Voxels, time_step, times_meta


class _ByNibabel(VoxelReader):
    """An image of three dimensions, perhaps with time, by a class of nibabel."""

    packages = ("nibabel",)
    extra = "medical"
    options = {  # noqa: RUF012 - as in Reader
        **VoxelReader.options,
        "time": "number of the time step or sub-volume, from 0, of a file with several",
    }
    library = ""

    def voxels(self, path: Path, *, time: int = 0) -> Voxels:
        with by_library("nibabel"):
            image = self._image(path)
            dtype, affine = _dtype(path, image), np.array(image.affine, float)
        sizes = checked_shape(image.shape)
        if len(sizes) not in (3, 4):
            raise FileFormatError(f"expected three dimensions, and time at most, got {sizes}")
        axis = self.axis_of_time(image) if len(sizes) == 4 else None
        times = 1 if axis is None else sizes[axis]
        step = time_step(time, times)
        chosen = tuple(step if k == axis else slice(None) for k in range(len(sizes)))
        shape = tuple(n for k, n in enumerate(sizes) if k != axis)

        def load(_: int) -> np.ndarray:
            check_memory(int(np.prod(shape, dtype=object)) * 8, f"reading {path.name}", "use NIfTI")
            with by_library("nibabel"):
                return np.asarray(self._image(path).dataobj[chosen], dtype)

        return Voxels(
            shape=shape,
            dtype=dtype,
            placement=Placement(affine[:3, 3], affine[:3, :3].T, "mm", "RAS"),
            load=load,
            meta=times_meta(times, step),
        )

    def axis_of_time(self, image: Any) -> int:
        """Return the axis that is not space."""
        return 3

    def _image(self, path: Path) -> Any:
        module, _, kind = self.library.rpartition(".")
        library = require(f"nibabel.{module}", self.extra, f"reading {self.description}")
        image = getattr(library, kind)
        if len(image.files_types) > 1:
            return image.from_filename(path)
        # The name of a single file need not have the usual ending.
        holders = require("nibabel.fileholders", self.extra, f"reading {self.description}")
        return image.from_file_map({"image": holders.FileHolder(str(path))})


def _dtype(path: Path, image: Any) -> np.dtype[Any]:
    """Return the type of true values: as stored, or real numbers where they are scaled.

    The last value is read for that, which reveals files that are cut short; of packed ones the
    first.
    """
    packed = path.suffix.lower() in (".gz", ".mgz", ".bz2", ".z")
    last = tuple(0 if packed else n - 1 for n in image.shape)
    true = np.asarray(image.dataobj[last]).dtype.newbyteorder("=")
    stored = np.dtype(image.get_data_dtype()).newbyteorder("=")
    if stored.kind not in "iuf":
        raise FileFormatError(f"expected real numbers, got {stored}")
    return true if true == stored or stored.itemsize == 8 else np.dtype(np.float32)


class MINCReader(_ByNibabel):
    """MINC 1 lies in NetCDF, MINC 2 in HDF5."""

    name = "minc"
    description = "a MINC image (.mnc)"
    suffixes = (".mnc",)

    def matches(self, path: Path, head: bytes) -> bool:
        if head.startswith(b"CDF\x01"):
            return all(word in head for word in (b"xspace", b"yspace", b"zspace"))
        return holds(path, head, lambda file: "minc-2.0" in file)

    def axis_of_time(self, image: Any) -> int:
        """Return the axis whose name is no direction of space."""
        names = image.dataobj.minc_file._dim_names
        return next(k for k, name in enumerate(names) if not name.endswith("space"))

    def _image(self, path: Path) -> Any:
        with open(path, "rb") as file:
            version = 1 if file.read(3) == b"CDF" else 2
        module = require(f"nibabel.minc{version}", self.extra, f"reading {self.description}")
        holders = require("nibabel.fileholders", self.extra, f"reading {self.description}")
        image = getattr(module, f"Minc{version}Image")
        return image.from_file_map({"image": holders.FileHolder(str(path))})


class MGHReader(_ByNibabel):
    """Big-endian numbers, perhaps packed by gzip."""

    name = "mgh"
    description = "a FreeSurfer image (.mgh, .mgz)"
    suffixes = (".mgh", ".mgz")
    library = "freesurfer.mghformat.MGHImage"

    def matches(self, path: Path, head: bytes) -> bool:
        start = unpacked_start(head, 30)[:30]
        if len(start) < 30 or not start.startswith(b"\0\0\0\1"):
            return False
        *sizes, kind = np.frombuffer(start, ">i4", 5, 4)
        good = int.from_bytes(start[28:30], "big")
        return all(0 < n < 1 << 20 for n in sizes) and kind in (0, 1, 3, 4, 10) and good in (0, 1)


class AFNIReader(_ByNibabel):
    """A text header, and sub-bricks beside it, which are taken for time steps."""

    name = "afni"
    description = "an AFNI image (.HEAD with .BRIK)"
    suffixes = (".head", ".brik", ".brik.gz")
    library = "brikhead.AFNIImage"

    def matches(self, path: Path, head: bytes) -> bool:
        if b"-attribute" in head[:100] and head.lstrip().startswith(b"type"):
            return True
        name, dot, _ = path.name.rpartition(".BRIK")
        return bool(dot) and path.with_name(f"{name}.HEAD").is_file()


class PARRECReader(_ByNibabel):
    """A text header, and slices beside it."""

    name = "parrec"
    description = "a Philips image (.PAR with .REC)"
    suffixes = (".par", ".rec")
    library = "parrec.PARRECImage"

    def matches(self, path: Path, head: bytes) -> bool:
        if b"DATA DESCRIPTION FILE" in head[:200]:
            return True
        pair = {".rec": ".par", ".REC": ".PAR"}.get(path.suffix)
        return pair is not None and path.with_suffix(pair).is_file()
