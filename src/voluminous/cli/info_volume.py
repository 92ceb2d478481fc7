"""What `voluminous info` tells of a volume file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import VoluminousError
from .info_grid import describe_grid
from .statistics import Statistics, histogram, numbers, statistics

if TYPE_CHECKING:
    from ..io import FieldInfo
    from ..volume import Volume

# A field whose greatest value is so many times its least is looked at logarithmically.
_WIDE = 1e2
# Chosen to look well: this part of the volume's width has optical depth one.
_PART = 4


def describe_volume(path: Path) -> Iterator[str]:
    """Yield lines about a volume file; one field at a time is in memory."""
    from ..io import find_reader
    from ..io import open as open_volume
    from ..io.guard import reading

    reader = find_reader(path)
    with reading(path, reader.description):
        fields = reader.info(path)
    yield f"{path}: {reader.description}, {_size(path)}"
    scenes: list[tuple[int, list[str]]] = []
    for number, field in enumerate(fields):
        try:
            volume = open_volume(path, {field.name: field.place})
        except VoluminousError as error:
            yield from ("", _title(field), f"  cannot be read: {error}")
            continue
        found = statistics(volume.array(field.name))
        if number == 0:
            yield from describe_grid(volume.grid)
        yield from ("", _title(field), *_values(volume.array(field.name), found))
        if found.least < found.greatest:
            scenes.append((found.size - found.finite, _scene(path, field, volume, found)))
    yield ""
    if not fields:
        yield "It holds no three-dimensional array of numbers."
    if scenes:
        yield "To see it, save this as scene.toml and type: voluminous render scene.toml"
        yield ""
        # The first of those fields with the fewest values that cannot be shown.
        yield from min(scenes, key=lambda scene: scene[0])[1]


def _values(array: Any, found: Statistics) -> Iterator[str]:
    yield f"  {numbers(found)}"
    if found.finite:
        scale = "logarithmic" if _is_wide(found) else "linear"
        yield f"  {histogram(array, found, _is_wide(found))}  {scale}"


def _is_wide(found: Statistics) -> bool:
    return found.least > 0 and found.greatest > _WIDE * found.least


def _title(field: FieldInfo) -> str:
    place = "" if field.place == field.name else f" at {field.place}"
    shape = " x ".join(map(str, field.shape))
    return f"{field.name}{place}: {field.dtype}, {shape}, {field.unit or 'no unit'}"


def _scene(path: Path, field: FieldInfo, volume: Volume, found: Statistics) -> list[str]:
    """Return a scene that shows a field through a colour table."""
    import math

    from ..scene.toml import dumps

    wide, low, high = _is_wide(found), found.least, found.greatest
    if wide:
        low, high = round(math.log10(low), 3), round(math.log10(high), 3)
    widest = float(max(b - a for a, b in volume.grid.bounds))
    medium: dict[str, Any] = {
        "type": "colormap",
        "expr": f"log10({field.name})" if wide else field.name,
        "cmap": "inferno",
        "vmin": low,
        "vmax": high,
        "opacity": 1.0,
        "path_length": widest / _PART,
    }
    fields = {field.name: field.place}
    scene = {"volume": {"path": str(path), "fields": fields}, "medium": [medium]}
    return dumps({**scene, "camera": {"incl": 60, "phi": 30}}).splitlines()


def _size(path: Path) -> str:
    size = float(path.stat().st_size)
    for unit in ("bytes", "KiB", "MiB", "GiB"):
        if size < 1024 or unit == "GiB":
            break
        size /= 1024
    return f"{size:.4g} {unit}"
