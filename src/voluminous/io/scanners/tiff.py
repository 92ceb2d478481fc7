"""Stacks of pictures: TIFF files of microscopes, ImageJ and micro-CT, and directories of slices.

Columns are x, rows y (downwards), pictures z. tifffile reads the files; what it logs of a chain
of pictures that leads out of the file is an error here.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from ...errors import FileFormatError
from ...memory import check_memory
from ...packages import require
from ..guard import by_library, reading
from ..payload import inside, stored
from .placement import conversion, equal_voxels, length_unit
from .voxels import (
    COLORS,
    TIMED,
    Y_DOWN,
    Channel,
    VoxelReader,
    Voxels,
    channel,
    component_names,
    of_samples,
    time_step,
    times_meta,
)

if TYPE_CHECKING:
    import tifffile

_MAGICS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_OPTIONS = {
    "spacing": "width of the voxels, or one per axis x, y, z; by default those in the file",
    "unit": "unit of length",
}
# What becomes the third axis, the first that there is: z; pictures one after the other; time or
# channels, as stacks of slices are called by those who did not say what they are.
_THIRD = "ZIQTC"
_TIFF = (".tif", ".tiff")
_SUFFIXES = (*_TIFF, ".png")
# Suffixes of files beside the slices that say how these were made.
_NOTES = {"", ".txt", ".log", ".xml", ".json", ".csv", ".ini", ".md", ".db", ".info"}
_NUMBER = re.compile(r"(\d+)")
_PNG_END = b"IEND\xaeB`\x82"
_TOO_FEW = "its description announces more pictures than there are"
# Kinds of pixels whose numbers are values, as tifffile and Pillow call them.
_MODES = ("YX", "YXS", "1", "L", "LA", "I", "I;16", "I;16B", "F", "RGB", "RGBA")


class _RaiseOfChain(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        # Odd tags do no harm; a chain of pictures that leads out of the file does, and a
        # description (270) that is missing.
        if re.search("TiffPages|TiffTag 270 ", record.getMessage()):
            raise FileFormatError(f"it is cut short or damaged: {record.getMessage()[:300]}")


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[tifffile.TiffFile]:
    tifffile = require("tifffile", "tiff", "reading TIFF")
    logger, handler = logging.getLogger("tifffile"), _RaiseOfChain(logging.ERROR)
    before = logger.propagate
    logger.propagate = False
    logger.addHandler(handler)
    try:
        with contextlib.ExitStack() as stack:
            stack.enter_context(by_library("tifffile"))
            file = stack.enter_context(tifffile.TiffFile(path, _multifile=False))
            whole, companion = _whole(path, file)
            if whole is not None:
                file = stack.enter_context(tifffile.TiffFile(whole, omexml=companion))
            yield file
    finally:
        logger.removeHandler(handler)
        logger.propagate = before


def _whole(path: Path, file: tifffile.TiffFile) -> tuple[Path | None, str | None]:
    """Return the file that describes a set in several files, or OME's text about it in another.

    Of a file that is complete neither. Files that are not there are named.
    """
    whole, companion = None, None
    text = (file.ome_metadata if file.is_ome else None) or "<OME/>"
    if (only := ElementTree.fromstring(text).find("{*}BinaryOnly")) is not None:
        _check_there(path, {name := only.get("MetadataFile", "")})
        if name.lower().endswith(_TIFF):
            raise FileFormatError(f"{name} tells of all files of this volume; open that one")
        whole, companion = path, (text := inside(path.parent, name).read_text())
    root = ElementTree.fromstring(text)
    parts = {(e.text, e.get("FileName", "")) for e in root.findall(".//{*}UUID")}
    if whole is None and (root.get("UUID") in {uuid for uuid, _ in parts} or len(parts) > 1):
        present = {root.get("UUID"), *(uuid for uuid, name in parts if name == path.name)}
        parts = {part for part in parts if part[0] not in present}
        whole = path if parts else None
    if whole is not None:
        _check_there(path, {name for _, name in parts})
    return whole, companion


def _check_there(path: Path, names: Iterable[str]) -> None:
    absent = sorted(name for name in names if not (path.parent / name).is_file())
    if absent:
        raise FileFormatError(
            f"it is one of several files that hold one volume; there is no {', '.join(absent[:8])}"
            f"{' …' * (len(absent) > 8)} beside it"
        )


class TIFFReader(VoxelReader):
    """A stack of pictures of one size, perhaps with channels and times."""

    name = "tiff"
    description = "a TIFF stack (.tif with several pictures)"
    suffixes = _TIFF
    packages = ("tifffile",)
    extra = "tiff"
    options = {  # noqa: RUF012 - as in Reader
        **TIMED,
        **_OPTIONS,
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return head.startswith(_MAGICS)

    def holds_image(self, path: Path) -> bool:
        try:
            with _opened(path) as file:
                pages: Any = file.pages
                pictures = sum(not page.is_reduced for page in pages)
                return pictures < 2 and not any(_third(_sizes(s)) for s in file.series)
        except (OSError, FileFormatError):
            return False  # the reader says what is wrong

    def voxels(self, path: Path, *, spacing: Any = None, unit: Any = None, time: int = 0) -> Voxels:
        with _opened(path) as file:
            number, series = _stack(file)
            sizes = _sizes(series)
            third = _third(sizes)
            widths, stored_unit = _scale(file, number)
            listed = _channels(file, number, sizes.get("C", 1))
            dtype = np.dtype(series.dtype)
        if third == "C" and any({"label", "color"} & entry.keys() for entry in listed):
            names = ", ".join(str(entry.get("label", "?")) for entry in listed)
            raise FileFormatError(
                f"expected a stack of pictures, got one of {len(listed)} channels ({names}): an "
                "image is no volume"
            )
        times = sizes.get("T", 1) if third != "T" else 1
        step = time_step(time, times)
        channels = sizes.get("C", 1) if third != "C" else 1
        samples = sizes.get("S", 1)

        def load(component: int) -> np.ndarray:
            at = {"T": step, "C": component // samples, "S": component % samples}
            return _read(path, number, {k: n for k, n in at.items() if k != third}, third)

        shape = (sizes["X"], sizes["Y"], sizes[third])
        return Voxels(
            shape=shape,
            dtype=np.dtype(np.float32) if dtype == np.float16 else dtype.newbyteorder("="),
            placement=equal_voxels(
                shape, widths if spacing is None else spacing, unit or stored_unit
            ),
            load=load,
            components=component_names(channels * samples, COLORS if channels == 1 else ()),
            channels=of_samples(samples) * channels if samples > 1 else listed[:channels],
            meta=Y_DOWN | times_meta(times, step),
        )


def _stack(file: tifffile.TiffFile) -> tuple[int, Any]:
    pairs = [zip(s.axes, s.shape, strict=True) for s in file.series]
    found = sum(math.prod(n for axis, n in pair if axis not in "XY") for pair in pairs)
    announced = 0
    if file.is_ome and file.ome_metadata:
        every = ElementTree.fromstring(file.ome_metadata).findall(".//{*}Pixels")
        announced = sum(math.prod(int(p.get(f"Size{a}", 1)) for a in "ZCT") for p in every)
    elif file.is_imagej:
        announced = int((file.imagej_metadata or {}).get("images", 1))
    elif file.is_shaped and len(file.pages) > sum(len(s.pages) for s in file.series):
        announced, found = found, len(file.pages)  # one page would stand for the bytes behind it
    if announced > found:
        raise FileFormatError(f"its description announces {announced} pictures, it has {found}")
    for number, series in enumerate(file.series):
        if _third(_sizes(series)):
            return number, series
    listed = ", ".join(f"{s.axes} {s.shape}" for s in file.series)
    raise FileFormatError(
        f"expected a stack of pictures, got axes {listed or 'of nothing'}: an image is no volume"
    )


def _sizes(series: Any) -> dict[str, int]:
    """Return the sizes of the axes that have any; refuses axes of unknown meaning."""
    pairs = zip(series.axes, series.shape, strict=True)
    remaining = [(axis, int(n)) for axis, n in pairs if n != 1 or axis in "XY"]
    sizes = dict(remaining)
    third = _third(sizes)
    strange = set(sizes) - {*"XYTCS", third} or len(sizes) < len(remaining)
    if third and (strange or not set("XY") <= set(sizes) or min(sizes.values()) < 1):
        raise FileFormatError(
            "expected axes X, Y, Z (or one unnamed), and perhaps channels C, samples S and time T, "
            f"got {series.axes} {series.shape}; write the stack with names for its axes"
        )
    return sizes


def _third(sizes: Mapping[str, int]) -> str:
    return next((axis for axis in _THIRD if axis in sizes), "")


def _read(path: Path, number: int, chosen: Mapping[str, int], third: str) -> np.ndarray:
    """Return part of a series, shape (columns, rows, pictures); read only that part."""
    with _opened(path) as file:
        series = file.series[number]
        index = tuple(chosen.get(axis, slice(None)) for axis in series.axes)
        if series.dataoffset is not None and not series.is_multifile:
            dtype = np.dtype(series.dtype).newbyteorder(file.byteorder)
            values = stored(path, series.dataoffset, series.shape, dtype, index)
        else:
            sizes = (math.prod(series.shape[:k]) for k in range(series.ndim))
            outer = next((k for k, n in enumerate(sizes) if n == len(series.pages)), None)
            if outer is None:
                raise FileFormatError(_TOO_FEW)
            numbers = np.arange(len(series.pages)).reshape(series.shape[:outer])[index[:outer]]
            keys = [int(k) for k in np.ravel(numbers)]
            _check_pages(path, [series.pages[k] for k in keys])
            values = file.asarray(key=keys, series=number)
            values = values.reshape(*np.shape(numbers), *series.shape[outer:])
            values = values[(slice(None),) * np.ndim(numbers) + index[outer:]]
        left = [a for a, k in zip(series.axes, index, strict=True) if isinstance(k, slice)]
    # Axes of size one that mean nothing may be left.
    order = [left.index(axis) for axis in ("X", "Y", third)]
    order += [k for k in range(len(left)) if k not in order]
    return np.asarray(values.transpose(order).reshape([values.shape[k] for k in order[:3]]))


def _check_pages(path: Path, pages: Sequence[Any]) -> None:
    """Reject pictures missing from the file: tifffile would fill them with zeros."""
    if any(page is None for page in pages):
        raise FileFormatError(_TOO_FEW)
    needed = math.prod(pages[0].keyframe.chunked)
    for number, page in enumerate(pages, start=1):
        ends, held = np.add(page.dataoffsets, page.databytecounts), page.parent.filehandle
        if len(ends) < needed or np.any(ends > held.size):
            raise FileFormatError(f"{held.name} is cut short: picture {number} is not all there")
    size = len(pages) * math.prod(pages[0].shape) * pages[0].dtype.itemsize
    check_memory(size, f"reading {path.name}", "are the sizes right?")


def _scale(file: Any, number: int) -> tuple[tuple[float, ...], str]:
    if file.is_ome and file.ome_metadata:
        pixels = _pixels(file, number)
        sizes = [float(pixels.get(f"PhysicalSize{axis}") or 0) for axis in "XYZ"]
        units = [length_unit(pixels.get(f"PhysicalSize{axis}Unit", "um")) for axis in "XYZ"]
        scaled = [n * conversion(unit, units[0]) for n, unit in zip(sizes, units, strict=True)]
        first = next(filter(None, scaled), 0.0)  # cubes, if a size is missing
        return tuple(n or first or 1.0 for n in scaled), units[0] if first else ""
    if not (file.is_imagej and file.imagej_metadata):
        return (1.0, 1.0, 1.0), ""  # the resolution of other files is that of paper
    notes, tags = file.imagej_metadata, file.pages.first.tags
    unit = length_unit(str(notes.get("unit", "")))
    widths = []
    for name in ("XResolution", "YResolution"):
        over, under = tags.valueof(name, (1, 1))
        # Without a unit of length resolutions are what a printer is to do.
        widths.append(under / over if unit and over and under else 1.0)
    depth = float(notes.get("spacing", 0)) if unit or "spacing" in notes else 0.0
    return (*widths, abs(depth) or widths[0]), unit


def _channels(file: Any, number: int, count: int) -> list[Channel]:
    listed: list[Channel] = []
    if file.is_ome and file.ome_metadata:
        for element in _pixels(file, number).findall("{*}Channel"):
            code = int(element.get("Color") or -1) % 2**32
            color = list(code.to_bytes(4, "big")[:3]) if element.get("Color") else None
            listed.append(channel(element.get("Name") or element.get("Fluor"), color))
    elif file.is_imagej and file.imagej_metadata:
        listed = _imagej_channels(file.imagej_metadata, count)
    return (listed + [{}] * count)[:count]


def _pixels(file: Any, number: int) -> ElementTree.Element:
    result = ElementTree.fromstring(file.ome_metadata).findall(".//{*}Pixels")
    return result[number] if number < len(result) else ElementTree.Element("Pixels")


def _imagej_channels(notes: Mapping[str, Any], count: int) -> list[Channel]:
    tables, ends = notes.get("LUTs") or [], list(notes.get("Ranges") or [])
    if not ends and count == 1 and {"min", "max"} <= set(notes):
        ends = [notes["min"], notes["max"]]
    entries = []
    for k in range(count):
        color = None
        table = np.asarray(tables[k], float) if k < len(tables) else np.empty(0)
        if table.shape == (3, 256):
            ramp = table[:, -1:] * np.linspace(0, 1, 256)
            color = table[:, -1] if np.abs(table - ramp).max() <= 2 else None
        entries.append(channel("", color, ends[2 * k : 2 * k + 2]))
    return entries


class PicturesReader(VoxelReader):
    """Pictures of one size and kind in a directory, sorted by the numbers in their names."""

    name = "pictures"
    description = "a directory of numbered pictures (.tif, .png), one per slice"
    options = {**VoxelReader.options, **_OPTIONS}  # noqa: RUF012 - as in Reader

    def matches(self, path: Path, head: bytes) -> bool:
        try:
            return path.is_dir() and len(_slices(path)) > 1
        except OSError:
            return False

    def voxels(self, path: Path, *, spacing: Any = None, unit: Any = None) -> Voxels:
        slices = _slices(path)
        if len(slices) < 2:
            raise FileFormatError(
                f"expected a directory of numbered pictures ({', '.join(_SUFFIXES)}) of one kind, "
                "with nothing else in it but notes"
            )
        first = _picture(slices[0])
        rows, columns, samples = first.shape
        shape = (columns, rows, len(slices))

        def load(sample: int) -> np.ndarray:
            out = np.empty((len(slices), rows, columns), first.dtype)
            for number, file in enumerate(slices):
                picture = _picture(file)
                if (picture.shape, picture.dtype) != (first.shape, first.dtype):
                    raise FileFormatError(
                        f"{file.name} is a picture of {picture.shape} {picture.dtype}, but "
                        f"{slices[0].name} is one of {first.shape} {first.dtype}"
                    )
                out[number] = picture[..., sample]
            return np.asarray(out.transpose())

        return Voxels(
            shape=shape,
            dtype=first.dtype.newbyteorder("="),
            placement=equal_voxels(shape, 1.0 if spacing is None else spacing, unit),
            load=load,
            components=component_names(samples, COLORS if samples > 2 else ("_0", "_alpha")),
            name=path.resolve().name,
            channels=of_samples(samples),
            meta=Y_DOWN,
        )


def _slices(directory: Path) -> list[Path]:
    """Return the pictures of a directory, in the order of their numbers; none if it is another."""
    with os.scandir(directory) as entries:
        names = [e.name for e in entries if not e.name.startswith(".") and e.is_file()]
    result = [n for n in names if n.lower().endswith(_SUFFIXES) and _NUMBER.search(Path(n).stem)]
    others = {Path(name).suffix.lower() for name in names if name not in result}
    if len({_NUMBER.sub("#", name) for name in result}) != 1 or not others <= _NOTES:
        return []
    ordered = sorted(result, key=lambda name: [int(number) for number in _NUMBER.findall(name)])
    return [directory / name for name in ordered]


def _picture(path: Path) -> np.ndarray:
    """Return a picture, shape (rows, columns, samples)."""
    from PIL import Image

    with reading(path, "a picture"):
        if path.suffix.lower() in _TIFF:
            with _opened(path) as file:
                page: Any = file.pages.first
                _check_pages(path, [page])
                kind, values = page.axes, page.asarray()
        else:
            if _PNG_END not in path.read_bytes()[-64:]:  # Pillow fills up what is missing
                raise FileFormatError("it is cut short: the end of a PNG file is missing")
            with Image.open(path) as picture:
                kind, values = picture.mode, np.asarray(picture)
        if kind not in _MODES:
            raise FileFormatError(f"expected rows and columns of values, got {kind}")
    return np.asarray(values if values.ndim == 3 else values[..., None])
