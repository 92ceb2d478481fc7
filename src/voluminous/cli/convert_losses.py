"""What a format could not hold: found by reading back what was written."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import VoluminousError

if TYPE_CHECKING:
    from ..io import Reader
    from ..volume import Volume


def losses(volume: Volume, path: Path, writer: Reader) -> Iterator[str]:
    """Yield a line for each thing that is in the volume and not in the file written of it."""
    from ..io.registry import open_lazily

    try:
        again = open_lazily(path, format=writer.name)
    except VoluminousError as error:
        yield f"  it cannot be read back: {error}"
        return
    yield from _grid(volume, again)
    yield from _fields(volume, again)
    lost = [key for key in volume.meta if key not in again.meta]
    if lost:
        yield f"  left out: {', '.join(lost)}"
    if volume.wcs is not None and again.wcs is None:
        yield "  left out: the world coordinates (WCS)"


def _grid(volume: Volume, again: Volume) -> Iterator[str]:
    mine, theirs = volume.grid.describe(), again.grid.describe()
    if mine["type"] != theirs["type"]:
        yield f"  the grid is {theirs['type']} there, {mine['type']} here"
    elif _unit(mine) != _unit(theirs):
        yield f"  lengths are in {_unit(theirs)} there, in {_unit(mine)} here"


def _unit(told: dict[str, Any]) -> str:
    return told["unit"] or "no unit"


def _fields(volume: Volume, again: Volume) -> Iterator[str]:
    mine, theirs = volume.describe()["fields"], again.describe()["fields"]
    lost = [name for name in mine if name not in theirs]
    new = [name for name in theirs if name not in mine]
    pairs = {name: name for name in mine if name in theirs}
    if len(lost) == len(new) == 1:  # formats of one field know no names
        yield f"  {lost[0]} is called {new[0]} there"
        pairs[lost[0]] = new[0]
    elif lost:
        yield f"  not there by that name: {', '.join(lost)}"
    for name, other in pairs.items():
        yield from _field(name, mine[name], theirs[other])


def _field(name: str, mine: dict[str, Any], theirs: dict[str, Any]) -> Iterator[str]:
    for key in ("dtype", "unit"):
        if mine[key] != theirs[key]:
            yield f"  {name}: {key} {mine[key] or 'none'} became {theirs[key] or 'none'}"
