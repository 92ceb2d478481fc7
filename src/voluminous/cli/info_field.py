"""What `voluminous info` tells of a field."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..errors import VoluminousError
from .choice import rank
from .statistics import Statistics, histogram, numbers, statistics, stride

if TYPE_CHECKING:
    from ..io import FieldInfo
    from ..volume import Volume

# A field whose greatest value is so many times its least is looked at logarithmically.
_WIDE = 1e2


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
    volume : Volume
        From which it can be read again.
    """

    field: FieldInfo
    found: Statistics | VoluminousError
    bytes: int
    volume: Volume

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
    again = volume.with_arrays({})  # knows nothing of what is read here
    try:
        array = volume.array(field.name)
    except VoluminousError as error:
        return Look(field, error, 0, again)
    return Look(field, statistics(array), array.nbytes, again)


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
