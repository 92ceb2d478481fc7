"""Text of `voluminous info` for a scene, an image or a volume."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import ceil, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import VoluminousError
from ..fields import is_angle
from ..files import url_of
from ..geometry import span
from .data import (
    DataFile,
    bytes_of,
    in_bytes,
    rank,
)
from .render_volume import LEVELS, PIXELS
from .statistics import ValueSummary, histogram, numbers, statistics, stride

if TYPE_CHECKING:
    from astropy.wcs import WCS

    from ..image import Image
    from ..io import FieldInfo
    from ..volume import Volume


# A histogram is logarithmic if maximum / smallest positive value exceeds this.
_WIDE = 1e2


@dataclass
class Look:
    """Summary of a field.

    Attributes
    ----------
    field : FieldInfo
        Its name, path, shape, type and unit in the file.
    found : ValueSummary or VoluminousError
        Statistics of its values, or the error that prevents reading them.
    bytes : int
        Its size in memory.
    volume : Volume
        Volume to read it from again.
    """

    field: FieldInfo
    found: ValueSummary | VoluminousError
    bytes: int
    volume: Volume

    @property
    def order(self) -> tuple[int, int]:
        """Sort key: interesting fields first; fields that cannot be shown last."""
        bad = 0 if isinstance(self.found, VoluminousError) else self.found.size - self.found.finite
        return rank(self.field.name), bad

    @property
    def varies(self) -> bool:
        """True if the values are readable and not constant."""
        return isinstance(self.found, ValueSummary) and self.found.least < self.found.greatest


def title(field: FieldInfo) -> str:
    """Return name, place, type, shape and unit of a field."""
    place = "" if field.place == field.name else f" at {field.place}"
    shape = " x ".join(map(str, field.shape))
    return f"{field.name}{place}: {field.dtype}, {shape}, {field.unit or 'no unit'}"


def look(field: FieldInfo, volume: Volume) -> Look:
    """Read a field and return its summary."""
    again = volume.with_arrays({})  # does not share the arrays read below
    try:
        array = volume.array(field.name)
    except VoluminousError as error:
        return Look(field, error, 0, again)
    return Look(field, statistics(array), array.nbytes, again)


def values(volume: Volume, seen: Look, bars: bool) -> Iterator[str]:
    """Yield range, histogram and non-finite values of a field."""
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


def _is_wide(found: ValueSummary) -> bool:
    return found.greatest > _WIDE * found.positive


def describe_grid(grid: Any, particles: int | None = None) -> Iterator[str]:
    """Yield lines about a grid: kind, cells, levels, extent, effective resolution.

    Parameters
    ----------
    grid : grid
    particles : int, optional
        Number of particles that the grid was built around; its cells are not from the file then.
    """
    told = grid.describe()
    refined = not grid.is_structured and "base" in told
    yield f"grid: {told['type']}, {_times(grid.shape)} cells{_kind(told)}"
    if particles is not None:
        yield f"  made by voluminous around {particles} particles, which have no cells of their own"
    yield from _extent(grid, told["unit"])
    if refined:
        yield from _levels(grid, told)


def _kind(told: dict[str, Any]) -> str:
    kind = {True: ", uniform", False: ", not uniform"}.get(told.get("uniform", ""), "")
    base = f", base {_times(told['base'])}" if "base" in told else ""
    return kind + base + (", mirrored at the midplane" if told.get("mirror") else "")


def _extent(grid: Any, unit: str) -> Iterator[str]:
    own = tuple(grid.coordinates)
    if own != ("x", "y", "z"):
        for name, edges in zip(own, grid.edges, strict=True):
            own_unit = "rad" if is_angle(name) else unit
            yield f"  {name}  {span(edges[0], edges[-1])} {own_unit}".rstrip()
    for axis, (low, high) in zip("xyz", grid.bounds, strict=True):
        if own == ("x", "y", "z") or axis not in own:
            yield f"  {axis}  {span(low, high)} {unit}".rstrip()


def _levels(grid: Any, told: dict[str, Any]) -> Iterator[str]:
    """Yield the number of cells of each level, their widths, and the effective resolution."""
    levels = np.reshape(grid.levels, -1)
    for level, count in enumerate(np.bincount(levels).tolist()):
        if count:
            widths = _widths(grid, levels, level)
            size = " x ".join(f"{w:.4g}" for w in widths)
            yield f"  level {level}: {count} cells of {size} {told['unit']}".rstrip()
    yield f"  effective resolution: {_times(_finest_across(grid, told['base'], levels))}"
    hidden = told.get("hidden_cells", 0)
    if hidden:
        yield f"  {hidden} more cells, under finer ones, are left out, here and in what follows"


def _finest_across(grid: Any, base: Any, levels: np.ndarray) -> np.ndarray:
    """Return the number of finest-level cells along each coordinate axis of the grid.

    They are counted, not computed from lengths: base cells and angles may be non-uniform.
    """
    first = int(np.argmax(levels == levels.max()))
    _, size = grid.boxes(first, first + 1)  # in the units of `divisions`
    return np.asarray(base) * grid.divisions // size[:, 0]


def _widths(grid: Any, levels: np.ndarray, level: int) -> np.ndarray:
    first = int(np.argmax(levels == level))
    return np.asarray(grid.cell_sizes(first, first + 1)[:, 0])


def _times(counts: Any) -> str:
    return " x ".join(str(n) for n in counts)


def describe_image(path: Path) -> Iterator[str]:
    """Yield lines about an image file."""
    from ..image import Image

    image = Image.load(path)
    ny, nx, channels = image.shape
    left, right, bottom, top = image.extent
    yield f"{path}: an image of {nx} x {ny} pixels, {channels} channel{'s' * (channels > 1)}"
    yield f"x {left:g} … {right:g}, y {bottom:g} … {top:g} {image.unit}".rstrip()
    yield ""
    yield f"intensity {image.intensity.dtype} {image.intensity_unit}".rstrip()
    for channel in range(channels):
        yield f"  channel {channel}: {numbers(statistics(image.intensity[..., channel]))}"
    for name in ("optical_depth", "transparency"):
        plane = getattr(image, name)
        if plane is not None:
            yield f"{name}: {numbers(statistics(plane))}"
    yield from _story(image)
    yield ""
    yield from _next(path, image)


def _story(image: Image) -> Iterator[str]:
    for title, known in (("camera", image.camera), ("made by", image.provenance)):
        if known:
            plain = {k: v for k, v in known.items() if not isinstance(v, dict)}
            yield f"{title}: " + ", ".join(f"{key} {value}" for key, value in plain.items())


def _next(path: Path, image: Image) -> Iterator[str]:
    name = shlex.quote(str(path))
    if (image.provenance or {}).get("scene"):
        yield "It carries its scene. Look at it from elsewhere:"
        yield f"  voluminous render {name} -o again.png --set camera.incl=40"
    yield "Next, in Python:"
    yield "  import voluminous as vm"
    yield f"  image = vm.Image.load({str(path)!r})"
    yield "  image.plot(scale_bar=True)"


_LONGEST, _UNIT = 100, "_unit"
# Metadata shown with the grid.
_TOLD_BY = ("particles",)


def describe_meta(volume: Volume) -> Iterator[str]:
    """Yield the other metadata of a file."""
    for key, value in volume.meta.items():
        told = _short(value)
        if told and key not in _TOLD_BY and not _is_unit(key, volume.meta):
            yield f"{key}: {told} {volume.meta.get(key + _UNIT, '')}".rstrip()
    if volume.wcs is not None:
        yield from _sky(volume.wcs)


def _is_unit(key: str, meta: Mapping[str, Any]) -> bool:
    """Return True for keys such as ``time_unit`` that are shown with their value ``time``."""
    return key.endswith(_UNIT) and key.removesuffix(_UNIT) in meta


def _short(value: Any) -> str:
    text = f"{value:.10g}" if isinstance(value, float) else str(value)
    first, *more = text.splitlines() or [""]
    return first if not more and len(first) <= _LONGEST else f"{first[:_LONGEST]} …"


def _sky(wcs: WCS) -> Iterator[str]:
    for name, kind, unit, value in zip(
        wcs.wcs.ctype, wcs.world_axis_physical_types, wcs.wcs.cunit, wcs.wcs.crval, strict=True
    ):
        told = f" ({kind})" if kind else ""
        yield f"world axis {name or 'without name'}{told}: reference {value:.8g} {unit}".rstrip()


_DIGITS = 4
# The centre of a shell is rounded to 10**-_FINE of its width: thin shells get more digits.
_FINE = 2
# Keys of a shell, other than its centre, in the unit of the expression.
_WIDTHS = ("sigma", "half_width")


def next_steps(data: DataFile, looks: list[Look]) -> Iterator[str]:
    """Yield suggested commands that show the fields."""
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
    except VoluminousError:  # rendering reports the error
        return
    from ..scene.settings import dumps

    yield "As a scene, to be changed (save it as scene.toml; then: voluminous render scene.toml):"
    yield ""
    yield from dumps({"volume": data.section(fields), **sections}).splitlines()


def _sections(volume: Volume, name: str) -> dict[str, Any]:
    """Return medium, camera and render sections as `voluminous render` chooses them, rounded."""
    from ..calibration import suggest_medium
    from ..cameras.views import view_angles

    medium = suggest_medium(volume, name, LEVELS)
    parts = [_told(part, volume) for part in medium.components()]
    more = {"render": {"scheme": "first-order"}} if medium.discrete else {}
    angles = {key: a for key, a in view_angles(volume.meta).items() if a or key != "posang"}
    camera = {**angles, "resolution": PIXELS}
    return {"medium": parts, "camera": camera, **more}


def _told(part: Any, volume: Volume) -> dict[str, Any]:
    """Return a shell as plain values with few digits; widths and centres include their unit."""
    from ..expressions import is_dex

    told = {key: value for key, value in part.describe().items() if value is not None}
    width = next(told[key] for key in _WIDTHS if key in told)
    unit = volume.expression_unit(part.expr)
    unit = None if is_dex(unit) else unit  # dex values are written as plain numbers
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


def describe_scene(path: Path) -> Iterator[str]:
    """Yield lines about a scene; its volume is not read."""
    from ..scene import Scene
    from ..scene.settings import inline

    scene = Scene.load(path)
    settings = scene.to_dict()
    yield f"{path}: a scene, all of it valid"
    for section, content in settings.items():
        for number, table in enumerate(content if isinstance(content, list) else [content], 1):
            yield ""
            yield f"{section} {number}" if isinstance(content, list) else section
            yield from _lines(table, inline)
    data = settings["volume"].get("path")
    if data is not None and not (url_of(Path(data)) or (scene.directory / data).exists()):
        yield ""
        yield f"There is no file {scene.directory / data}: put it there, or change volume.path"
    yield ""
    yield f"Next: voluminous render {shlex.quote(str(path))}"


def _lines(table: Mapping[str, Any], inline: Any) -> Iterator[str]:
    width = max(map(len, table))
    for key, value in table.items():
        yield f"  {key:{width}}  {inline(value)}"


# A field, and the volume to read it from, or the error that prevents it.
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
        del volume[field.name]  # free its memory
    yield from _rest(known, looks)
    yield from next_steps(data, looks)


def _nothing(data: DataFile) -> Iterator[str]:
    yield "It holds no three-dimensional array of numbers."
    try:
        data.open()
    except VoluminousError as error:
        yield str(error)


def _about(volume: Volume, told: Any) -> Iterator[str]:
    """Yield lines about the grid, unless the one before was the same, and the metadata."""
    if told is None:
        yield from describe_grid(volume.grid, volume.meta.get("particles"))
        yield from describe_meta(volume)
    elif volume.grid.describe() != told.describe():
        yield ""
        yield from describe_grid(volume.grid)


def _readable(data: DataFile, known: Iterable[FieldInfo]) -> Iterator[Readable]:
    """Yield the fields to describe: the requested ones, or the reader's default.

    The file is opened once, or once per field if the fields do not fit together.
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
    """Return the volume's description of a field, for user-chosen names."""
    from ..io import FieldInfo

    dtype = str(volume.describe()["fields"][name]["dtype"])
    return FieldInfo(name, name, volume.grid.shape, dtype, volume.units[name])


def _rest(known: Iterable[FieldInfo], looks: list[Look]) -> Iterator[str]:
    """Yield the memory use of the fields, and the names of the other fields."""
    if looks:
        sizes = [found.bytes for found in looks]
        total = f"{in_bytes(sum(sizes))} for all, " if len(sizes) > 1 else ""
        yield ""
        yield f"memory: {total}{in_bytes(max(sizes))} for {'one field' if total else 'the field'}"
    others = sorted({f.name for f in known} - {found.field.name for found in looks}, key=rank)
    if others and looks:
        yield f"more fields (--fields): {', '.join(others)}"
