"""Text of `voluminous info` for a scene, an image or a volume."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator
from math import ceil, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import VoluminousError
from ..fields import is_angle
from ..files import url_of
from ..geometry import CARTESIAN, span
from .data import (
    DataFile,
    bytes_of,
    in_bytes,
    rank,
)
from .render import LEVELS, PIXELS
from .statistics import histogram, numbers, statistics

if TYPE_CHECKING:
    from ..grids.contract import Grid
    from ..io import FieldInfo
    from ..volume import Volume


# Texts of metadata longer than this are cut.
_LONGEST, _UNIT = 100, "_unit"
_DIGITS = 4
# The centre of a shell is rounded to 10**-_FINE of its width: thin shells get more digits.
_FINE = 2
# Keys of a shell, other than its centre, in the unit of the expression.
_WIDTHS = ("sigma", "half_width")


def describe_volume(data: DataFile, *, bars: bool = True) -> Iterator[str]:
    """Yield lines about a volume file; one field at a time is in memory."""
    reader, fields = data.info()
    url = url_of(data.path)
    size = "" if url else f", {in_bytes(bytes_of(data.path))}"
    yield f"{url or data.path}: {reader.description}{size}; format {reader.name}"
    if not fields:
        yield "It holds no three-dimensional array of numbers."
        try:
            data.open()
        except VoluminousError as error:
            yield str(error)
        return
    grid: Grid | None = None
    sizes: dict[str, int] = {}
    varying: list[tuple[int, int, FieldInfo, Volume]] = []
    for field, volume in _readable(data, fields):
        if not isinstance(volume, VoluminousError) and volume.grid is not grid:
            if grid is None:
                yield from describe_grid(volume.grid, volume.meta.get("particles"))
                yield from _meta(volume)
            elif volume.grid.describe() != grid.describe():
                yield ""
                yield from describe_grid(volume.grid)
            grid = volume.grid
        place = "" if field.place == field.name else f" at {field.place}"
        shape = " x ".join(map(str, field.shape))
        yield ""
        yield f"{field.name}{place}: {field.dtype}, {shape}, {field.unit or 'no unit'}"
        try:
            if isinstance(volume, VoluminousError):
                raise volume
            again = volume.with_arrays({})  # does not share the array read below
            sizes[field.name] = 0
            array = volume.array(field.name)
        except VoluminousError as error:
            yield f"  cannot be read: {error}"
            continue
        sizes[field.name] = array.nbytes
        summary = statistics(array)
        yield f"  {numbers(summary, volume.grid.shape)}"
        if summary.finite and bars:
            yield f"  {histogram(array, summary)}"
        if summary.varies:
            varying.append((rank(field.name), summary.size - summary.finite, field, again))
        del array, volume[field.name]  # free its memory
    if sizes:
        largest = in_bytes(max(sizes.values()))
        total = f"{in_bytes(sum(sizes.values()))} for all, " if len(sizes) > 1 else ""
        yield ""
        yield f"memory: {total}{largest} for {'one field' if total else 'the field'}"
        if others := sorted({field.name for field in fields} - sizes.keys(), key=rank):
            yield f"more fields (--fields): {', '.join(others)}"
    if varying:
        _, _, field, volume = min(varying, key=lambda row: row[:2])
        yield from _next_steps(data, field, volume)


def _readable(
    data: DataFile, fields: Iterable[FieldInfo]
) -> Iterator[tuple[FieldInfo, Volume | VoluminousError]]:
    """Yield the fields to describe: the requested ones, or the reader's default.

    The file is opened once, or once per field if the fields do not fit together.
    """
    from ..io import FieldInfo

    try:
        volume = data.open()
    except VoluminousError:
        if data.fields is not None:
            raise
        for field in fields:
            try:
                yield field, data.open({field.name: field.place})
            except VoluminousError as error:
                yield field, error
        return
    by_name = {field.name: field for field in fields}
    for name in volume.fields:
        dtype = str(volume.describe()["fields"][name]["dtype"])
        renamed = FieldInfo(name, name, volume.grid.shape, dtype, volume.units[name])
        yield by_name.get(name, renamed), volume


def describe_grid(grid: Any, particles: int | None = None) -> Iterator[str]:
    """Yield lines about a grid: kind, cells, levels, extent, effective resolution.

    A grid built around particles has no cells of the file; `particles` is their number.
    """
    known = grid.describe()
    unit, base = known["unit"], known.get("base")
    kind = {True: ", uniform", False: ", not uniform"}.get(known.get("uniform", ""), "")
    kind += f", base {_times(base)}" if base is not None else ""
    kind += ", mirrored at the midplane" if known.get("mirror") else ""
    yield f"grid: {known['type']}, {_times(grid.shape)} cells{kind}"
    if particles is not None:
        yield f"  made by voluminous around {particles} particles, which have no cells of their own"
    ends = dict(zip(CARTESIAN, grid.bounds, strict=True))
    if (axes := tuple(grid.coordinates)) != CARTESIAN:
        ends |= {name: edges[[0, -1]] for name, edges in zip(axes, grid.edges, strict=True)}
    for name in dict.fromkeys((*(axes if axes != CARTESIAN else ()), *CARTESIAN)):
        yield f"  {name}  {span(*ends[name])} {'rad' if is_angle(name) else unit}".rstrip()
    if len(grid.shape) == 3 or base is None:
        return
    levels = np.reshape(grid.levels, -1)
    for level, count in enumerate(np.bincount(levels).tolist()):
        if count:
            first = int(np.argmax(levels == level))
            sides = np.asarray(grid.cell_sizes(first, first + 1)[:, 0])
            size = " x ".join(f"{side:.4g}" for side in sides)
            yield f"  level {level}: {count} cells of {size} {unit}".rstrip()
    # Counted, not computed from lengths: base cells and angles may be non-uniform.
    finest = int(np.argmax(levels))
    _, steps = grid.boxes(finest, finest + 1)  # in the units of `divisions`
    across = np.asarray(base) * grid.divisions // steps[:, 0]
    yield f"  effective resolution: {_times(across)}"
    if hidden := known.get("hidden_cells", 0):
        yield f"  {hidden} more cells, under finer ones, are left out, here and in what follows"


def _times(counts: Iterable[int]) -> str:
    return " x ".join(map(str, counts))


def _meta(volume: Volume) -> Iterator[str]:
    for key, value in volume.meta.items():
        is_unit = key.endswith(_UNIT) and key.removesuffix(_UNIT) in volume.meta
        text = f"{value:.10g}" if isinstance(value, float) else str(value)
        first, *more = text.splitlines() or [""]
        if text and key != "particles" and not is_unit:
            shown = f"{first[:_LONGEST]} …" if more or len(first) > _LONGEST else first
            yield f"{key}: {shown} {volume.meta.get(key + _UNIT, '')}".rstrip()
    if volume.wcs is not None:
        wcs = volume.wcs.wcs
        kinds = volume.wcs.world_axis_physical_types
        for name, kind, unit, value in zip(wcs.ctype, kinds, wcs.cunit, wcs.crval, strict=True):
            kind = f" ({kind})" if kind else ""
            line = f"world axis {name or 'without name'}{kind}: reference {value:.8g} {unit}"
            yield line.rstrip()


def _next_steps(data: DataFile, field: FieldInfo, volume: Volume) -> Iterator[str]:
    """Yield suggested commands that show a field, and the scene that `voluminous render` makes."""
    from ..calibration import suggest_medium
    from ..cameras.views import view_angles
    from ..scene.settings import dumps

    yield from ("", "To see it:", f"  voluminous render {data.words()} --field {field.name}")
    yield from ("In Python:", f"  volume = {data.call()}")
    try:
        medium = suggest_medium(volume, field.name, LEVELS)
    except VoluminousError:  # rendering reports the error
        return
    fields: Any = [field.name] if field.place == field.name else {field.name: field.place}
    angles = {key: a for key, a in view_angles(volume.meta).items() if a or key != "posang"}
    sections: dict[str, Any] = {
        "volume": data.section(fields),
        "medium": [
            part.describe() if medium.discrete else _rounded_shell(part, volume)
            for part in medium.components()
        ],
        "camera": {**angles, "resolution": PIXELS},
    }
    yield "As a scene, to be changed (save it as scene.toml; then: voluminous render scene.toml):"
    yield ""
    yield from dumps(sections).splitlines()


def _rounded_shell(part: Any, volume: Volume) -> dict[str, Any]:
    """Return a shell as plain values with few digits; widths and centres include their unit."""
    from ..expressions import is_dex
    from ..units import unit_name

    def rounded(value: float, unit: Any = None, digits: int = _DIGITS) -> Any:
        text = f"{value:.{digits}g}"
        return float(text) if unit is None else f"{text} {unit_name(unit)}"

    shell = {key: value for key, value in part.describe().items() if value is not None}
    width = next(shell[key] for key in _WIDTHS if key in shell)
    unit = volume.expression_unit(part.expr)
    unit = None if is_dex(unit) else unit  # dex values are written as plain numbers
    center, digits = shell["center"], _DIGITS
    if center:
        digits = max(digits, _FINE + ceil(log10(abs(center) / width)))
    return {
        **shell,
        "center": rounded(center, unit, digits),
        **{key: rounded(shell[key], unit) for key in _WIDTHS if key in shell},
        "path_length": rounded(shell["path_length"], volume.unit),
        "color": [rounded(value) for value in shell["color"]],
        "opacity": rounded(shell["opacity"]),
    }


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
    for title, known in (("camera", image.camera), ("made by", image.provenance)):
        if known:
            plain = [f"{key} {v}" for key, v in known.items() if not isinstance(v, dict)]
            yield f"{title}: {', '.join(plain)}"
    yield ""
    if (image.provenance or {}).get("scene"):
        yield "It carries its scene. Look at it from elsewhere:"
        yield f"  voluminous render {shlex.quote(str(path))} -o again.png --set camera.incl=40"
    yield "Next, in Python:"
    yield "  import voluminous as vm"
    yield f"  image = vm.Image.load({str(path)!r})"
    yield "  image.plot(scale_bar=True)"


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
            width = max(map(len, table))
            yield from (f"  {key:{width}}  {inline(value)}" for key, value in table.items())
    data = settings["volume"].get("path")
    if data is not None and not (url_of(Path(data)) or (scene.directory / data).exists()):
        yield ""
        yield f"There is no file {scene.directory / data}: put it there, or change volume.path"
    yield ""
    yield f"Next: voluminous render {shlex.quote(str(path))}"
