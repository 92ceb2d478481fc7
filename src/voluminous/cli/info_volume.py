"""What `voluminous info` tells of a volume file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from ..errors import VoluminousError
from .choice import rank
from .data import DataFile
from .info_field import Look, look, title, values
from .info_grid import describe_grid
from .info_meta import describe_meta
from .info_next import next_steps
from .sizes import bytes_of, in_bytes

if TYPE_CHECKING:
    from ..io import FieldInfo
    from ..volume import Volume

# A field, and the volume that it can be read from; or why it cannot.
Readable = tuple["FieldInfo", "Volume | VoluminousError"]


def describe_volume(data: DataFile, *, histogram: bool = True) -> Iterator[str]:
    """Yield lines about a volume file; one field at a time is in memory."""
    from ..io import find_reader
    from ..io.guard import reading

    reader = find_reader(data.path, data.format)
    with reading(data.path, reader.description):
        known = reader.info(data.path, **data.typed())
    size = in_bytes(bytes_of(data.path))
    yield f"{data.path}: {reader.description}, {size}; format {reader.name}"
    if not known:
        yield from _nothing(data)
        return
    looks: list[Look] = []
    told: Any = None
    for field, volume in _readable(data, known):
        if isinstance(volume, VoluminousError):
            yield from ("", title(field), f"  cannot be read: {volume}")
            continue
        if volume.grid is not told:
            yield from _about(volume, told)
            told = volume.grid
        yield from ("", title(field))
        found = look(field, volume)
        yield from values(volume, found, histogram)
        looks.append(found)
        del volume[field.name]  # what was read is given back
    yield from _rest(known, looks)
    yield from next_steps(data, looks)


def _nothing(data: DataFile) -> Iterator[str]:
    yield "It holds no three-dimensional array of numbers."
    try:
        data.open()
    except VoluminousError as error:
        yield str(error)


def _about(volume: Volume, told: Any) -> Iterator[str]:
    """Yield lines about the grid, unless the one before was the same, and what else is known."""
    if told is None:
        yield from describe_grid(volume.grid, volume.meta.get("particles"))
        yield from describe_meta(volume)
    elif volume.grid.describe() != told.describe():
        yield ""
        yield from describe_grid(volume.grid)


def _readable(data: DataFile, known: Iterable[FieldInfo]) -> Iterator[Readable]:
    """Yield the fields to be told of: those asked for, or all that are read by default.

    The file is opened once; where its fields do not fit together, once for each.
    """
    try:
        volume = data.open()
    except VoluminousError:
        if data.fields is not None:
            raise
        for field in known:
            yield field, _alone(data, field)
        return
    by_name = {field.name: field for field in known}
    for name in volume.fields:
        yield by_name.get(name) or _told_by(volume, name), volume


def _alone(data: DataFile, field: FieldInfo) -> Volume | VoluminousError:
    try:
        return data.open({field.name: field.place})
    except VoluminousError as error:
        return error


def _told_by(volume: Volume, name: str) -> FieldInfo:
    """Return what a volume tells of a field, such as one with a name of the user's."""
    from ..io import FieldInfo

    dtype = str(volume.describe()["fields"][name]["dtype"])
    return FieldInfo(name, name, volume.grid.shape, dtype, volume.units[name])


def _rest(known: Iterable[FieldInfo], looks: list[Look]) -> Iterator[str]:
    """Yield what the fields take, and the names of those that were not looked at."""
    if looks:
        sizes = [found.bytes for found in looks]
        total = f"{in_bytes(sum(sizes))} for all, " if len(sizes) > 1 else ""
        yield ""
        yield f"memory: {total}{in_bytes(max(sizes))} for {'one field' if total else 'the field'}"
    others = sorted({f.name for f in known} - {found.field.name for found in looks}, key=rank)
    if others and looks:
        yield f"more fields (--fields): {', '.join(others)}"
