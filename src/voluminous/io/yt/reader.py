"""Detection of simulation outputs by content, without importing yt (which takes seconds)."""

from __future__ import annotations

import contextlib
import importlib
import importlib.metadata
import re
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...files import check_readable
from ...packages import is_installed, require
from ...units import UnitLike, unit_name
from ..contract import FieldChoice, FieldInfo, Reader
from ..hdf5 import check_places, first_bytes, is_hdf5, opened
from .layout import length_unit
from .source import quiet, source_of, units_of_field
from .volume import fields_of, volume_of

if TYPE_CHECKING:
    from ...volume import Volume

# Required in the root of an HDF5 file: groups or data sets, and attributes.
_HDF5_CODES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "FLASH": (("bounding box", "node type"), ()),
    "Chombo": (("Chombo_global",), ("num_levels",)),
    "GDF": (("gridded_data_format",), ()),
    "GAMER": (("Info/KeyInfo",), ()),
    "Chimera": (("fluid/agr_c", "fluid/grav_x_c"), ()),
    "Parthenon": (("Info", "Levels", "LogicalLocations", "Locations/x"), ()),
    "Cholla": ((), ("bounds", "domain", "dims")),
    "yt": (("data",), ("data_type", "container_type")),
}
_RAMSES_FILE = re.compile(r"(info|amr|hydro|header)_(\d{5})\.(txt|out\d{5})")
_ENZO_ENDING = re.compile(r"\.(hierarchy|cpu\d{4,})$")


def code_output(path: Path, head: bytes) -> Path | None:
    """Return the path to pass to yt for the supported output that contains `path`."""
    for recognise in (_ramses, _enzo, _amrex, _hdf5, _amrvac, _enzo_e):
        with contextlib.suppress(Exception):  # damaged beyond recognition
            if (output := recognise(path, head)) is not None:
                return output
    return None


def _only(files: Iterable[Path | None]) -> Path | None:
    """Return the file if there is exactly one; among several outputs the user must choose."""
    existing = [file for file in files if file is not None]
    return existing[0] if len(existing) == 1 else None


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
    """Return Enzo's parameter file (one with a file of grids beside it) that a file belongs to."""
    if path.is_dir():
        return _only(_enzo(hierarchy, b"") for hierarchy in path.glob("*.hierarchy"))
    parameters = path.with_name(_ENZO_ENDING.sub("", path.name))
    hierarchy = parameters.with_name(parameters.name + ".hierarchy")
    return parameters if parameters.is_file() and hierarchy.is_file() else None


def _amrex(path: Path, head: bytes) -> Path | None:
    directory = path if path.is_dir() else path.parent
    if not (path.is_dir() or path.name == "Header") or not (directory / "Level_0").is_dir():
        return None
    version, count, *_ = [*first_bytes(directory / "Header", 160).split(b"\n"), b"", b""]
    return directory if re.match(rb"[\w-]+-V\d", version) and count.strip().isdigit() else None


def _hdf5(path: Path, head: bytes) -> Path | None:
    if is_hdf5(head):
        with opened(path) as file:
            for places, attributes in _HDF5_CODES.values():
                if all(p in file for p in places) and all(a in file.attrs for a in attributes):
                    return path
    return None


def _amrvac(path: Path, head: bytes) -> Path | None:
    """Detect MPI-AMRVAC: version 3 to 5, and valid offsets of the tree and the blocks."""
    if path.suffix != ".dat" or len(head) < 12:
        return None
    version, *offsets = struct.unpack("=iii", head[:12])
    size = path.stat().st_size
    return path if 3 <= version <= 5 and all(12 < o < size for o in offsets) else None


def _enzo_e(path: Path, head: bytes) -> Path | None:
    if path.is_dir():
        listed = _only(path.glob("*.block_list"))
        return None if listed is None else _enzo_e(listed, _head(listed))
    if not path.name.endswith(".block_list"):
        return None
    words = head.partition(b"\n")[0].decode("ascii").split()
    named = len(words) == 2 and words[0].startswith("B") and (path.parent / words[1]).is_file()
    return path if named else None


def _head(path: Path) -> bytes:
    if path.is_dir():
        return b""
    return first_bytes(path, 512)


class YtReader(Reader):
    """Outputs of RAMSES, Enzo, FLASH, AMReX, Chombo, GAMER … by their content, read by yt."""

    name = "yt"
    description = "an output of a simulation code that yt reads"
    packages = ("yt",)
    extra = "yt"
    options = {  # noqa: RUF012 - as in Reader
        "unit": "unit of length of the grid",
        "units": "units of fields, {name: unit}; by default those of yt",
        "bounds": "a box to read, in the unit of length: ((x0, x1), (y0, y1), (z0, z1))",
        "units_override": "the code's units, where the file does not tell: {'length_unit': …}",
        "load": "further arguments of yt.load, {name: value}",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return code_output(path, head) is not None

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        unit: UnitLike = options.get("unit")
        with quiet(f"reading {self.description}"):
            ds = _loaded(path, options)
            bounds = options.get("bounds")
            data = ds if bounds is None else _box(ds, bounds, unit)
            return volume_of(data, fields, unit=unit, units=options.get("units"))

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        wanted = options.get("units") or {}
        with quiet(f"reading {self.description}"):
            ds = _loaded(path, options)
            source = source_of(ds)
            if source.kind == "particles":
                count = int(sum(ds.particle_type_counts.values()))
            elif source.kind == "grids":
                count = int(ds.index.grid_dimensions.prod(axis=1).sum())
            else:
                count = sum(len(level) for level, _ in source.cells())
            known = fields_of(source)
            fields = [(n, p, known.fields[p], wanted.get(n)) for p, n in known.on_disk.items()]
            units = [unit_name(units_of_field(ds, f, unit)[1]) for _, _, f, unit in fields]
        return tuple(
            FieldInfo(name, place, (count,), "float64", unit)
            for (name, place, _, _), unit in zip(fields, units, strict=True)
        )


class AnyYtReader(YtReader):
    """Files that no other reader recognizes but yt does."""

    name = "yt-any"
    description = "a file that yt reads"

    def __init__(self, reader_for_suffix: Callable[[Path], Reader | None]) -> None:
        self._named = reader_for_suffix

    def matches(self, path: Path, head: bytes) -> bool:
        # A damaged file of another format is not for yt, and asking yt takes seconds.
        if self._named(path) or not (head or path.is_dir()) or not is_installed("yt"):
            return False
        try:
            with quiet():
                return bool(_kinds(path))
        except Exception:  # an unreadable path
            return False


def _loaded(path: Path, options: dict[str, Any]) -> Any:
    head = _head(path)
    output = code_output(path, head) or path
    if is_hdf5(head):
        _check_places(path)
    load = dict(options.get("load") or {})
    if options.get("units_override") is not None:
        load["units_override"] = options["units_override"]
    ds = _kind(output, str(load.pop("hint", "")))(str(output), **load)
    ds.index  # noqa: B018 - a damaged file raises here
    return ds


def _check_places(path: Path) -> None:
    """Refuse an HDF5 output whose cells yt would misplace."""
    check_places(path)
    with opened(path) as file:
        blocks = file["Info"].attrs if "Locations" in file and "Info" in file else {}
        if np.any(blocks.get("IncludesGhost", 0)):
            raise InputError("its blocks have ghost cells; write it with ghost_zones = false")
        level = file["level_0"].attrs if "Chombo_global" in file and "level_0" in file else {}
        normal = {"geometry": 1, "logr": 0, "g_x2stretch": 1, "g_x3stretch": 1}
        if any(level.get(name, value) != value for name, value in normal.items()):
            raise InputError(
                "Chombo grids of PLUTO are read if they are Cartesian with equal cells; this one "
                f"has { ({name: level.get(name) for name in normal}) }"
            )
        begins = [level.get(f"domBeg{axis}", 0) for axis in (1, 2, 3)]
        if any(begins) and not path.with_name("pluto.ini").is_file():
            raise InputError(
                f"its domain begins at {begins}, which yt reads from the run's pluto.ini only: put "
                "that beside it"
            )


def _kinds(path: Path) -> list[Any]:
    """Return the most specific yt classes that claim a file.

    As in yt.load, except that a class that fails on another format's file does not hide the rest.
    """
    for inner in path.iterdir() if path.is_dir() else ():
        check_readable(inner)
    # yt registers its frontends on its first load.
    for name in require("yt.frontends", "yt", "reading this file").__all__:
        with contextlib.suppress(Exception):
            importlib.import_module(f"yt.frontends.{name}.api")
    for entry in importlib.metadata.entry_points(group="yt.frontends"):
        with contextlib.suppress(Exception):
            entry.load()
    claiming = []
    for kind in require("yt.utilities.object_registries", "yt", "").output_type_registry.values():
        with contextlib.suppress(Exception):
            if kind._is_valid(str(path)):
                claiming.append(kind)
    return [k for k in claiming if not any(o is not k and issubclass(o, k) for o in claiming)]


def _kind(path: Path, hint: str) -> Any:
    claiming = _kinds(path)
    kinds = [kind for kind in claiming if hint.lower() in kind.__name__.lower()]
    if len(kinds) == 1:
        for module in kinds[0]._missing_load_requirements():
            require(module, "yt", "reading this file")
        return kinds[0]
    if claiming:
        names = ", ".join(kind.__name__ for kind in claiming)
        raise InputError(f"to yt it may be {names}: choose one with load={{'hint': '…'}}")
    raise FileFormatError(
        "yt does not recognise it: it is incomplete, of another kind, or has not the name that its "
        "code gives it (Parthenon: .phdf)"
    )


def _box(ds: Any, bounds: Any, unit: UnitLike) -> Any:
    from ...grids import CartesianGrid

    if str(ds.geometry) != "cartesian":
        raise InputError(f"bounds are of Cartesian data, these are in {ds.geometry} coordinates")
    length, factor = length_unit(ds, float(ds.domain_width.to("code_length").d.max()), unit)
    box = CartesianGrid.uniform(1, bounds, unit=length)
    factor *= 1.0 if box.unit is None else length.to(box.unit)
    return ds.box(*(ds.arr(ends / factor, "code_length") for ends in box.bounds.T))
