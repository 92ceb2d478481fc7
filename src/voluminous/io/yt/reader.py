"""Files that yt reads: outputs of many simulation codes."""

from __future__ import annotations

import contextlib
import importlib
import importlib.metadata
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import FileFormatError, InputError
from ...packages import is_installed, require
from ...units import parse_unit, unit_name
from ..contract import FieldInfo, Reader
from ..hdf5 import is_hdf5
from .lattice import length_unit
from .quiet import quiet
from .signatures import code_output
from .soundness import check_output, check_places
from .source import source_of
from .strangers import may_be_of_yt
from .units import units_of_field
from .volume import fields_of, volume_of

if TYPE_CHECKING:
    from ...volume import Volume


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

    def read(
        self,
        path: Path,
        fields: Any = None,
        *,
        unit: Any = None,
        units: Any = None,
        bounds: Any = None,
        **options: Any,
    ) -> Volume:
        with quiet(f"reading {self.description}"):
            ds = _loaded(path, **options)
            data = ds if bounds is None else _box(ds, bounds, unit)
            return volume_of(data, fields, unit=unit, units=units)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        told = {name: options.get(name) for name in ("units_override", "load")}
        with quiet(f"reading {self.description}"):
            ds = _loaded(path, **told)
            places, shape = fields_of(source_of(ds)).on_disk, (_cell_count(ds),)
            wanted = options.get("units") or {}
            return tuple(
                FieldInfo(name, place, shape, "float64", _unit(ds, name, place, wanted))
                for place, name in places.items()
            )


class AnyYtReader(YtReader):
    """Files that no other reader knows, if yt says it knows them."""

    name = "yt-any"
    description = "a file that yt reads"

    def __init__(self, reader_for_suffix: Callable[[Path], Reader | None]) -> None:
        self._named = reader_for_suffix

    def matches(self, path: Path, head: bytes) -> bool:
        # A damaged file of another format is none of yt's, and it takes seconds to ask.
        if self._named(path) or not (head or path.is_dir()) or not is_installed("yt"):
            return False
        try:
            if not may_be_of_yt(path, head):
                return False
            with quiet():
                return bool(_kinds(path))
        except Exception:  # a path that cannot be looked into
            return False


def _loaded(path: Path, *, units_override: Any = None, load: Any = None) -> Any:
    head = _head(path)
    output = code_output(path, head) or path
    check_output(output)
    if is_hdf5(head):
        check_places(path)
    options = dict(load or {})
    if units_override is not None:
        options["units_override"] = units_override
    ds = _kind(output, str(options.pop("hint", "")))(str(output), **options)
    ds.index  # noqa: B018 - what is damaged shows here
    return ds


def _kinds(path: Path) -> list[Any]:
    """Return the classes of yt that claim a file, the most special ones.

    As in yt.load, but one that fails over another's file does not hide the rest.
    """
    # yt registers its frontends when it first loads a file.
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


def _head(path: Path) -> bytes:
    if path.is_dir():
        return b""
    with open(path, "rb") as file:
        return file.read(256)


def _box(ds: Any, bounds: Any, unit: Any) -> Any:
    from ...grids import CartesianGrid

    if str(ds.geometry) != "cartesian":
        raise InputError(f"bounds are of Cartesian data, these are in {ds.geometry} coordinates")
    width = float(ds.domain_width.to("code_length").d.max())
    unit, factor = length_unit(ds, width, unit)
    box = CartesianGrid.uniform(1, bounds, unit=unit)
    factor *= 1.0 if box.unit is None else unit.to(box.unit)
    left, right = (ds.arr(ends / factor, "code_length") for ends in box.bounds.T)
    return ds.box(left, right)


def _cell_count(ds: Any) -> int:
    source = source_of(ds)
    if source.kind == "particles":
        return int(sum(ds.particle_type_counts.values()))
    if source.kind == "grids":
        return int(ds.index.grid_dimensions.prod(axis=1).sum())
    return sum(len(level) for level, _ in source.cells())


def _unit(ds: Any, name: str, place: str, wanted: Any) -> str:
    if name in wanted:
        return unit_name(parse_unit(wanted[name]))
    kind, _, last = place.partition("/")
    return unit_name(units_of_field(ds, (kind, last))[1])
