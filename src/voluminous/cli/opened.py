"""A data file opened to show one of its fields."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..errors import VoluminousError
from .data import DataFile

if TYPE_CHECKING:
    from ..volume import Volume


@dataclass
class Opened:
    """A volume with fields that are not read yet; their places, if it matters where they are."""

    volume: Volume
    places: dict[str, str] | None = None

    def keep(self, used: set[str]) -> Any:
        """Forget what is not used, and return how a scene names the other fields."""
        for name in self.volume.fields:
            if name not in used:
                del self.volume[name]
        names = list(self.volume.fields)
        return names if self.places is None else {name: self.places[name] for name in names}


def opened(data: DataFile, expr: str | None) -> Opened:
    """Return all fields; where they do not fit together, those of the expression, or the first."""
    try:
        return Opened(data.open())
    except VoluminousError:
        if data.fields is not None:
            raise
        for places in _alternatives(data, expr):
            try:
                return Opened(data.open(places), places)
            except VoluminousError:
                continue
        raise


def _alternatives(data: DataFile, expr: str | None) -> Iterator[dict[str, str]]:
    from ..expressions import Expression
    from ..io import find_reader
    from ..io.guard import reading
    from .choice import rank

    reader = find_reader(data.path, data.format)
    with reading(data.path, reader.description):
        known = reader.info(data.path, **data.typed())
    if expr is None:
        for field in sorted(known, key=lambda field: rank(field.name)):
            yield {field.name: field.place}
    else:
        names = Expression(expr).names
        yield {field.name: field.place for field in reversed(known) if field.name in names}
