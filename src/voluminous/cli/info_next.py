"""What `voluminous info` says to type next: a command, Python, a scene to be changed."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, log10
from typing import TYPE_CHECKING, Any

from ..errors import VoluminousError
from .data import DataFile
from .info_field import Look
from .render_volume import LEVELS, PIXELS

if TYPE_CHECKING:
    from ..volume import Volume

_DIGITS = 4
# More digits where a shell is thin: its place is told to 10 to the minus this of its width.
_FINE = 2
# What is in the unit of the expression, beside the place of a shell.
_WIDTHS = ("sigma", "half_width")


def next_steps(data: DataFile, looks: list[Look]) -> Iterator[str]:
    """Yield what to type next to see the fields."""
    shown = sorted((seen for seen in looks if seen.varies), key=lambda seen: seen.order)
    if not shown:
        return
    field = shown[0].field
    fields = {field.name: field.place} if field.place != field.name else [field.name]
    yield from ("", "To see it:")
    yield f"  voluminous render {data.words()} --field {field.name}"
    yield "In Python:"
    yield f"  volume = {data.call()}"
    try:
        sections = _sections(shown[0].volume, field.name)
    except VoluminousError:  # it says so when it is rendered
        return
    from ..scene.toml import dumps

    yield "As a scene, to be changed (save it as scene.toml; then: voluminous render scene.toml):"
    yield ""
    yield from dumps({"volume": data.section(fields), **sections}).splitlines()


def _sections(volume: Volume, name: str) -> dict[str, Any]:
    """Return all of a scene but its volume: what `voluminous render` chooses, in short numbers."""
    from ..calibration import auto
    from ..cameras.views import view_angles

    medium = auto(volume, name, LEVELS)
    parts = [_told(part, volume) for part in medium.components()]
    more = {"render": {"scheme": "first-order"}} if medium.discrete else {}
    angles = {key: a for key, a in view_angles(volume.meta).items() if a or key != "posang"}
    camera = {**angles, "resolution": PIXELS}
    return {"medium": parts, "camera": camera, **more}


def _told(part: Any, volume: Volume) -> dict[str, Any]:
    """Return a shell as plain values with few digits, lengths and places with their unit."""
    from ..expressions import is_dex

    told = {key: value for key, value in part.describe().items() if value is not None}
    width = next(told[key] for key in _WIDTHS if key in told)
    unit = volume.expression_unit(part.expr)
    unit = None if is_dex(unit) else unit  # plain numbers of dex are short
    told["center"] = _with_unit(told["center"], unit, _digits(told["center"], width))
    told |= {key: _with_unit(told[key], unit) for key in _WIDTHS if key in told}
    told["path_length"] = _with_unit(told["path_length"], volume.unit)
    told["color"] = [_rounded(value) for value in told["color"]]
    told["opacity"] = _rounded(told["opacity"])
    return told


def _digits(center: float, width: float) -> int:
    return max(_DIGITS, _FINE + ceil(log10(abs(center) / width))) if center else _DIGITS


def _with_unit(value: float, unit: Any, digits: int = _DIGITS) -> Any:
    from ..units import unit_name

    return _rounded(value, digits) if unit is None else f"{value:.{digits}g} {unit_name(unit)}"


def _rounded(value: float, digits: int = _DIGITS) -> float:
    return float(f"{value:.{digits}g}")
