"""MRC and CCP4 maps (.mrc, .map, .ccp4, .rec): what electron microscopes and crystals give."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...packages import require
from ..guard import by_library
from ..payload import checked_shape
from .placement import Placement
from .stored import StoredNumbers
from .voxels import VoxelReader, Voxels, time_step, times_meta

_MAP = slice(208, 211)
_HEAD, _VOLUME_STACKS = 1024, range(401, 631)
# IMOD writes plain bytes without a sign, unless a flag says otherwise.
_IMOD, _SIGNED = b"IMOD", 1


class MRCReader(VoxelReader):
    """A density map of three axes, in any order, in units of an Angstrom."""

    name = "mrc"
    description = "an MRC or CCP4 map (.mrc, .map, .ccp4, .rec)"
    suffixes = (".mrc", ".map", ".ccp4", ".rec")
    packages = ("mrcfile",)
    extra = "medical"
    options = {  # noqa: RUF012 - as in Reader
        **VoxelReader.options,
        "time": "number of the volume, from 0, of a stack of volumes",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return len(head) >= _HEAD and head[_MAP] == b"MAP"

    def voxels(self, path: Path, *, time: int = 0) -> Voxels:
        mrcfile = require("mrcfile", self.extra, f"reading {self.description}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what matters is checked here
            with by_library("mrcfile"), mrcfile.open(path, "r", True, header_only=True) as file:
                head = file.header
        columns = checked_shape([head.nx, head.ny, head.nz], "nx, ny, nz")
        order = [int(head[name]) - 1 for name in ("mapc", "mapr", "maps")]
        order = [0, 1, 2] if order == [-1] * 3 else order
        angles = np.array(head.cellb.tolist())
        if sorted(order) != [0, 1, 2] or np.any(abs(angles - 90) > 0.01) & np.any(angles != 0):
            raise FileFormatError(
                f"expected axes at right angles, got the axes {[k + 1 for k in order]} at angles "
                f"{angles.tolist()}; resample the map on such axes first"
            )
        times = 1
        if int(head.ispg) in _VOLUME_STACKS:
            times, rest = divmod(columns[2], max(int(head.mz), 1))
            if rest:
                raise FileFormatError(f"a stack of volumes of {head.mz} sections has {columns[2]}")
        elif int(head.ispg) == 0 and int(head.mz) == 1 < columns[2]:
            raise FileFormatError(
                f"it is a stack of {columns[2]} separate pictures (ISPG = 0, MZ = 1), no volume"
            )
        shape = (*columns[:2], columns[2] // times)
        dtype = _dtype(mrcfile, head)
        count = math.prod(shape)
        stored = StoredNumbers(
            (path,), dtype, count * times, skipped=_HEAD + int(head.nsymbt)
        ).check()
        step = time_step(time, times)
        final = np.dtype(np.float32) if dtype.kind == "f" else dtype.newbyteorder("=")
        return Voxels(
            shape=shape,
            dtype=final,
            placement=_placement(head, order),
            load=lambda _: np.asarray(stored.read(step * count, shape[::-1]).transpose(), final),
            meta=times_meta(times, step),
        )


def _placement(head: Any, order: list[int]) -> Placement:
    """Return where voxels are: by the origin, or by the number of the first voxel."""
    cell, intervals = np.array(head.cella.tolist()), np.array([head.mx, head.my, head.mz])
    known = np.all(cell > 0) and np.all(intervals > 0)
    widths = cell / np.maximum(intervals, 1) if known else np.ones(3)
    first = np.zeros(3)
    first[order] = [head.nxstart, head.nystart, head.nzstart]
    origin = np.array(head.origin.tolist())
    origin = origin if np.any(origin) else first * widths
    return Placement(origin, np.diag(widths)[order], "Angstrom" if known else "")


def _dtype(mrcfile: Any, head: Any) -> np.dtype[Any]:
    with by_library("mrcfile"):
        dtype = mrcfile.utils.data_dtype_from_header(head)
    if dtype.kind not in "iuf" or int(head.mode) > 12:
        raise FileFormatError(f"mode must be 0, 1, 2, 6 or 12 (real numbers), got {head.mode}")
    extra = bytes(head.extra2)[40:48]
    if dtype.itemsize == 1 and extra[:4] in (_IMOD, _IMOD[::-1]):
        flags = int.from_bytes(extra[4:], "little" if extra[:4] == _IMOD else "big")
        return np.dtype(np.int8 if flags & _SIGNED else np.uint8)
    return dtype
