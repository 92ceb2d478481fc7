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
from ..payload import checked_shape, stored
from .placement import Placement
from .voxels import TIMED, VoxelReader, Voxels, time_step, times_meta

_MAP = slice(208, 211)
# Bytes of a voxel, by the mode of the numbers.
_BYTES = {0: 1, 1: 2, 2: 4, 6: 2, 12: 2}
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
    options = TIMED

    def matches(self, path: Path, head: bytes) -> bool:
        return len(head) >= _HEAD and (head[_MAP] == b"MAP" or _is_unmarked(path, head))

    def voxels(self, path: Path, *, time: int = 0) -> Voxels:
        header, start, kind = self._header(path)
        columns = checked_shape([header.nx, header.ny, header.nz], "nx, ny, nz")
        if int(header.mode) not in _BYTES:
            raise FileFormatError(f"mode must be 0, 1, 2, 6 or 12 (real), got {header.mode}")
        order = [int(header[name]) - 1 for name in ("mapc", "mapr", "maps")]
        order = [0, 1, 2] if order == [-1] * 3 else order
        angles = np.array(header.cellb.tolist())
        if sorted(order) != [0, 1, 2] or np.any(abs(angles - 90) > 0.01) & np.any(angles != 0):
            raise FileFormatError(
                f"expected axes at right angles, got the axes {[k + 1 for k in order]} at angles "
                f"{angles.tolist()}; resample the map on such axes first"
            )
        group, sections = int(header.ispg), int(header.mz)
        times = columns[2] // max(sections, 1) if group in _VOLUME_STACKS else 1
        if columns[2] % times:
            raise FileFormatError(f"a stack of volumes of {sections} sections has {columns[2]}")
        if group == 0 and sections == 1 < columns[2]:
            raise FileFormatError(
                f"it is a stack of {columns[2]} separate pictures (ISPG = 0, MZ = 1), no volume"
            )
        shape = (*columns[:2], columns[2] // times)
        step = time_step(time, times)
        dtype = kind.newbyteorder("=")
        extra = bytes(header.extra2)[40:48]
        if dtype.itemsize == 1 and extra[:4] in (_IMOD, _IMOD[::-1]):
            flags = int.from_bytes(extra[4:], "little" if extra[:4] == _IMOD else "big")
            dtype = np.dtype(np.int8 if flags & _SIGNED else np.uint8)
        dtype = np.dtype(np.float32) if dtype.kind == "f" else dtype

        def load(_: int) -> np.ndarray:
            first = start + step * math.prod(shape) * kind.itemsize
            values = stored(path, first, shape[::-1], kind).transpose()
            return values.view(dtype) if dtype.itemsize == 1 else np.asarray(values, dtype)

        return Voxels(
            shape=shape,
            dtype=dtype,
            placement=_placement(header, order),
            load=load,
            meta=times_meta(times, step),
        )

    def _header(self, path: Path) -> tuple[Any, int, np.dtype[Any]]:
        mrcfile = require("mrcfile", self.extra, f"reading {self.description}")
        with warnings.catch_warnings(), by_library("mrcfile"):
            warnings.simplefilter("ignore")  # of unusual headers
            with mrcfile.open(path, "r", permissive=True, header_only=True) as file:
                start = file.header.nbytes + int(file.header.nsymbt)
                return file.header, start, mrcfile.utils.data_dtype_from_header(file.header)


def _is_unmarked(path: Path, head: bytes) -> bool:
    """Return True for a header without the mark, as before 2000: the file is as long as it says."""
    for order in "<>":
        *shape, mode = np.frombuffer(head, f"{order}i4", 4).tolist()
        extra = int(np.frombuffer(head, f"{order}i4", 1, 92)[0])
        size = _HEAD + extra + math.prod(shape) * _BYTES.get(mode, 0)
        if min(*shape, mode + 1) > 0 and mode in _BYTES and path.stat().st_size == size:
            return path.suffix.lower() in MRCReader.suffixes
    return False


def _placement(header: Any, order: list[int]) -> Placement:
    cell, intervals = np.array(header.cella.tolist()), np.array([header.mx, header.my, header.mz])
    known = np.all(cell > 0) and np.all(intervals > 0)
    widths = cell / np.maximum(intervals, 1) if known else np.ones(3)
    first = np.zeros(3)
    first[order] = [header.nxstart, header.nystart, header.nzstart]
    origin = np.array(header.origin.tolist())
    # Without the mark there are other numbers.
    origin = origin if np.any(origin) and header.map in (b"MAP ", b"MAP", b"") else first * widths
    return Placement(origin, np.diag(widths)[order], "Angstrom" if known else "")
