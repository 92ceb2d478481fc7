"""What `voluminous info` tells of a field, and how it says to look at it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..errors import VoluminousError
from .choice import rank
from .data import DataFile
from .statistics import Statistics, histogram, numbers, statistics, stride

if TYPE_CHECKING:
    from ..io import FieldInfo
    from ..volume import Volume

# A field whose greatest value is so many times its least is looked at logarithmically.
_WIDE = 1e2
# Chosen to look well: this part of the volume's width has optical depth one.
_PART = 4


@dataclass
class Look:
    """What was seen of a field.

    Attributes
    ----------
    field : FieldInfo
        What the file tells of it.
    found : Statistics or VoluminousError
        What its values are, or why they cannot be read.
    bytes : int
        Memory that it takes.
    width : float
        That of the volume.
    """

    field: FieldInfo
    found: Statistics | VoluminousError
    bytes: int
    width: float

    @property
    def order(self) -> tuple[int, int]:
        """How late one would look at it: by its name, and by what cannot be shown."""
        bad = 0 if isinstance(self.found, VoluminousError) else self.found.size - self.found.finite
        return rank(self.field.name), bad

    @property
    def varies(self) -> bool:
        """True if there is anything to see."""
        return isinstance(self.found, Statistics) and self.found.least < self.found.greatest


def title(field: FieldInfo) -> str:
    """Return name, place, type, shape and unit of a field."""
    place = "" if field.place == field.name else f" at {field.place}"
    shape = " x ".join(map(str, field.shape))
    return f"{field.name}{place}: {field.dtype}, {shape}, {field.unit or 'no unit'}"


def look(field: FieldInfo, volume: Volume) -> Look:
    """Return what there is in a field, which is read for it."""
    width = float(max(b - a for a, b in volume.grid.bounds))
    try:
        array = volume.array(field.name)
    except VoluminousError as error:
        return Look(field, error, 0, width)
    return Look(field, statistics(array), array.nbytes, width)


def values(volume: Volume, seen: Look, bars: bool) -> Iterator[str]:
    """Yield range, histogram and what is not finite of a field."""
    found = seen.found
    if isinstance(found, VoluminousError):
        yield f"  cannot be read: {found}"
        return
    yield f"  {numbers(found, volume.grid.shape)}"
    if found.finite and bars:
        array, step = volume.array(seen.field.name), stride(found.size)
        wide = array.dtype.kind == "f" and found.least >= 0 and _is_wide(found)
        scale = "logarithmic" if wide else "linear"
        scale += ", of those above zero" if wide and not found.least else ""
        scale += f", of one value in {step}" if step > 1 else ""
        yield f"  {histogram(array, found, wide)}  {scale}"


def _is_wide(found: Statistics) -> bool:
    return found.greatest > _WIDE * found.positive


def next_steps(data: DataFile, looks: list[Look]) -> Iterator[str]:
    """Yield what to type next to see the fields."""
    shown = sorted((seen for seen in looks if seen.varies), key=lambda seen: seen.order)
    if not shown:
        return
    yield ""
    field = shown[0].field
    fields = {field.name: field.place} if field.place != field.name else [field.name]
    yield "To see it:"
    yield f"  voluminous render {data.words()} --field {field.name}"
    yield "In Python:"
    yield f"  volume = {data.call()}"
    yield "As a scene, to be changed (save it as scene.toml; then: voluminous render scene.toml):"
    yield ""
    yield from _scene(data, fields, shown[0])


def _scene(data: DataFile, fields: Any, seen: Look) -> list[str]:
    """Return a scene that shows a field through a colour table."""
    from ..scene.toml import dumps

    found, name = seen.found, seen.field.name
    assert isinstance(found, Statistics)
    low, high = found.least, found.greatest
    wide = low > 0 and _is_wide(found)
    if wide:
        low, high = round(math.log10(low), 3), round(math.log10(high), 3)
    medium: dict[str, Any] = {
        "type": "colormap",
        "expr": f"log10({name})" if wide else name,
        "cmap": "inferno",
        "vmin": low,
        "vmax": high,
        "opacity": 1.0,
        "path_length": seen.width / _PART,
    }
    scene = {"volume": data.section(fields), "medium": [medium]}
    return dumps({**scene, "camera": {"incl": 60, "phi": 30}}).splitlines()
