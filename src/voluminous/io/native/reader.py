"""Native files: what `Volume.save` writes, whatever the grid."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...deferred import Deferred
from ...errors import FileFormatError
from ...units import parse_unit, unit_name
from ..contract import FieldInfo, Reader
from ..hdf5 import opened
from ..names import chosen_fields
from . import layout
from .arrays import ALIGNMENT, field_values, is_plain, loaded, sound_array
from .extras import read_extras, write_extras
from .grids import PlainGrid, grid_of, plain_grid
from .units import exact_name

if TYPE_CHECKING:
    from ...volume import Volume

_PACKED: dict[str, Any] = {"chunks": True, "shuffle": True, "compression": "gzip"}


class NativeReader(Reader):
    """HDF5 with a mark: the grid, of any kind, the fields, and what else is known."""

    name = "voluminous"
    description = "a volume saved by voluminous (HDF5)"
    suffixes = (".h5", ".hdf5")
    writes = True
    write_options = {"compress": "True to pack the fields (gzip)"}  # noqa: RUF012 - as in Reader

    def matches(self, path: Path, head: bytes) -> bool:
        return layout.is_native(path, head)

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        from ...volume import Volume

        with opened(path) as file:
            layout.check_version(file)
            volume = Volume(_read_grid(_group(file, layout.GRID)))
            read_extras(file, volume)
            group = _group(file, layout.FIELDS)
            for name, place in chosen_fields({name: name for name in group}, fields).items():
                volume[name] = _deferred(path, group, place, volume.grid.shape)
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        with opened(path) as file:
            layout.check_version(file)
            group = _group(file, layout.FIELDS)
            return tuple(_info(name, sound_array(group, name)) for name in group)

    def write(self, volume: Volume, path: Path, *, compress: bool = False) -> None:
        """Write a volume of any grid.

        Parameters
        ----------
        volume : Volume
        path : Path
        compress : bool
            Pack the fields; numbers hardly get smaller, and packed ones cannot be mapped.
        """
        from ... import __version__
        from ..hdf5 import created

        plain = plain_grid(volume.grid)
        aligned = {"alignment_threshold": 1024, "alignment_interval": ALIGNMENT}
        with created(path, **aligned) as (file, sink):
            told = {"format": layout.MARK, "version": layout.VERSION, "about": layout.ABOUT}
            file.attrs.update({**told, "written_by": f"voluminous {__version__}"})
            _write_grid(file, plain)
            write_extras(file, volume)
            group = file.create_group(layout.FIELDS, track_order=True)
            for name in volume.fields:
                options = _PACKED if compress else {}
                # Of a copy, which forgets what it has read: one field at a time is in memory.
                values = volume.with_arrays({}).array(name)
                item = group.create_dataset(name, data=values, **options)
                item.attrs["units"] = exact_name(volume.field_unit(name))
                sink.check()


def _info(name: str, item: Any) -> FieldInfo:
    unit = unit_name(parse_unit(layout.attribute(item, "units")))
    return FieldInfo(name, name, item.shape, str(item.dtype), unit)


def _group(file: Any, name: str) -> Mapping[str, Any]:
    import h5py

    link = file.get(name, getlink=True)
    item = file[name] if isinstance(link, h5py.HardLink) else None
    if not isinstance(item, h5py.Group):
        raise FileFormatError(f"expected a group /{name}")
    return item


def _write_grid(file: Any, plain: PlainGrid) -> None:
    group = file.create_group(layout.GRID)
    group.attrs.update({"type": plain.type, "order": plain.order, **plain.attributes})
    for name, values in plain.arrays.items():
        group[name] = values


def _read_grid(group: Any) -> Any:
    arrays = {name: loaded(group, name) for name in group}
    attributes = {name: value for name, value in group.attrs.items() if name != "unit"}
    attributes["unit"] = layout.attribute(group, "unit")
    return grid_of(PlainGrid(layout.attribute(group, "type"), "", arrays, attributes))


def _deferred(path: Path, group: Any, name: str, shape: tuple[int, ...]) -> Deferred:
    item = sound_array(group, name)
    if item.shape != shape:
        raise FileFormatError(
            f"{item.name} has shape {item.shape}, expected {shape}, one value per cell of the grid"
        )
    load = functools.partial(field_values, path, layout.FIELDS, name)
    return Deferred(load, item.dtype, layout.attribute(item, "units"), is_plain(item))
