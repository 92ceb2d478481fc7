"""The skeleton of most readers: a format lists its fields and makes a grid, read one by one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..deferred import Deferred, Pieces
from ..units import UnitLike, parse_unit, unit_name
from .contract import FieldChoice, FieldInfo, Reader
from .names import chosen_fields

if TYPE_CHECKING:
    from ..grids.contract import Grid
    from ..volume import Volume


@dataclass(frozen=True)
class StoredField:
    """A field in a file: its description, and a function that reads it."""

    name: str
    place: str
    shape: tuple[int, ...]
    dtype: Any
    unit: UnitLike
    load: Callable[[], Any]  # returns what `Volume` accepts as a field
    pieces: Pieces | None = None

    @property
    def info(self) -> FieldInfo:
        """The description without the function."""
        unit = unit_name(parse_unit(self.unit))
        return FieldInfo(self.name, self.place, self.shape, str(self.dtype), unit)


@dataclass(frozen=True)
class Contents:
    """The contents of a file; `grid` returns the grid of some of its fields."""

    fields: Sequence[StoredField]
    grid: Callable[[Sequence[StoredField]], Grid]
    meta: dict[str, Any] = field(default_factory=dict)  # complete once the grid is made


class ContentsReader(Reader):
    """Base of the readers that need to provide `contents` only."""

    def contents(self, path: Path, **options: Any) -> Contents:
        """Return the contents of a file, without field values."""
        raise NotImplementedError

    def chosen(self, contents: Contents, fields: FieldChoice) -> Mapping[str, StoredField]:
        """Return {name: field} for the fields that the user requests."""
        by_place = {f.place: f for f in contents.fields}
        names = {f.place: f.name for f in contents.fields}
        return {name: by_place[place] for name, place in chosen_fields(names, fields).items()}

    def finish(self, volume: Volume, contents: Contents) -> None:
        """Add to a volume what is neither a grid, a field nor metadata."""

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        from ..volume import Volume

        contents = self.contents(path, **options)
        chosen = self.chosen(contents, fields)
        volume = Volume(contents.grid(list(chosen.values())))
        volume.meta.update(contents.meta)
        for name, f in chosen.items():
            volume[name] = Deferred(f.load, f.dtype, f.unit, f.pieces)
        self.finish(volume, contents)
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        return tuple(f.info for f in self.contents(path, **options).fields)
