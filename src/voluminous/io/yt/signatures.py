"""What the files of simulation codes look like, without asking yt: it takes seconds to import."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable
from pathlib import Path

from ..hdf5 import is_hdf5, opened

# What must be in the root of an HDF5 file: groups or data sets, and attributes.
_HDF5_CODES: dict[str, tuple[set[str], set[str]]] = {
    "FLASH": ({"bounding box", "node type"}, set()),
    "Chombo": ({"Chombo_global"}, {"num_levels"}),
    "GDF": ({"gridded_data_format"}, set()),
    "GAMER": ({"Info/KeyInfo"}, set()),
    "Chimera": ({"fluid/agr_c", "fluid/grav_x_c"}, set()),
    "Parthenon": ({"Info", "Levels", "LogicalLocations", "Locations/x"}, set()),
    "Cholla": (set(), {"bounds", "domain", "dims"}),
    "yt": ({"data"}, {"data_type", "container_type"}),
}
_RAMSES_FILE = re.compile(r"(info|amr|hydro|header)_(\d{5})\.(txt|out\d{5})")
_ENZO_ENDING = re.compile(r"\.(hierarchy|cpu\d{4,})$")


def code_output(path: Path, head: bytes) -> Path | None:
    """Return the path that yt wants for an output of a code it knows, of which `path` is a part.

    Parameters
    ----------
    path : Path
        A file or directory.
    head : bytes
        The first bytes of a file.

    Returns
    -------
    Path or None
        None if it is no such output, as far as can be told.
    """
    for recognise in (_ramses, _enzo, _amrex, _hdf5, _amrvac, _enzo_e):
        try:
            found = recognise(path, head)
        except Exception:  # what is damaged beyond recognition
            continue
        if found is not None:
            return found
    return None


def _ramses(path: Path, head: bytes) -> Path | None:
    if path.is_dir():
        infos = sorted(path.glob("info_[0-9][0-9][0-9][0-9][0-9].txt"))
        return infos[0] if infos and any(path.glob("amr_*.out*")) else None
    named = _RAMSES_FILE.fullmatch(path.name)
    if named is None:
        return None
    info = path.with_name(f"info_{named[2]}.txt")
    return info if info.is_file() and any(path.parent.glob(f"amr_{named[2]}.out*")) else None


def _enzo(path: Path, head: bytes) -> Path | None:
    if path.is_dir():
        return _only(file for h in path.glob("*.hierarchy") if (file := _parameters(h)))
    return _parameters(path)


def _parameters(path: Path) -> Path | None:
    """Return Enzo's file of parameters, which has one of grids beside it, that a file goes with."""
    parameters = path.with_name(_ENZO_ENDING.sub("", path.name))
    if not parameters.is_file():
        return None
    return parameters if parameters.with_name(parameters.name + ".hierarchy").is_file() else None


def _only(files: Iterable[Path]) -> Path | None:
    """Return the one file that there is; which of several outputs is meant the user has to say."""
    found = list(files)
    return found[0] if len(found) == 1 else None


def _amrex(path: Path, head: bytes) -> Path | None:
    directory = path if path.is_dir() else path.parent
    header = directory / "Header"
    if not (path.is_dir() or path.name == "Header") or not (directory / "Level_0").is_dir():
        return None
    with open(header, "rb") as file:
        version, count = file.readline(80), file.readline(80)
    return directory if re.match(rb"[\w-]+-V\d", version) and count.strip().isdigit() else None


def _hdf5(path: Path, head: bytes) -> Path | None:
    if not is_hdf5(head):
        return None

    with opened(path) as file:
        for places, attributes in _HDF5_CODES.values():
            if all(p in file for p in places) and all(a in file.attrs for a in attributes):
                return path
    return None


def _amrvac(path: Path, head: bytes) -> Path | None:
    """MPI-AMRVAC: a version from 3 to 5, and where in the file tree and blocks are."""
    if path.suffix != ".dat" or len(head) < 12:
        return None
    version, *offsets = struct.unpack("=iii", head[:12])
    size = path.stat().st_size
    return path if 3 <= version <= 5 and all(12 < o < size for o in offsets) else None


def _enzo_e(path: Path, head: bytes) -> Path | None:
    if path.is_dir():
        listed = _only(path.glob("*.block_list"))
        return None if listed is None else _enzo_e(listed, _start(listed))
    if not path.name.endswith(".block_list"):
        return None
    words = head.partition(b"\n")[0].decode("ascii").split()
    found = len(words) == 2 and words[0].startswith("B") and (path.parent / words[1]).is_file()
    return path if found else None


def _start(path: Path) -> bytes:
    with open(path, "rb") as file:
        return file.read(512)
