"""Stacks of pictures: TIFF files of microscopes, ImageJ and micro-CT, and directories of slices."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any
from xml.etree import ElementTree

import numpy as np

from ...errors import FileFormatError
from ...packages import require
from ..arrays.layout import equal_cells
from ..channels import Y_DOWN, Channel, channel, of_samples
from ..guard import reading
from ..payload import mapped
from .placement import Placement, conversion, length_unit
from .voxels import COLORS, VoxelReader, Voxels, components, time_step

MAGICS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_SUBFILE, _DESCRIPTION, _DEPTH = 254, 270, 32997
_REDUCED = 1  # a smaller copy of another picture
# Bytes of a value of each type, by the number of the type.
_TYPE_SIZES = np.array([0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8])
_FIRST_PRIVATE = 32768  # in tags of their own, makers of programs may write what they like
# A single directory can stand for a stack that follows in one piece.
_STACK = re.compile(
    rb'images=0*([2-9]|1\d)|\bSizeZ="0*([2-9]|1\d)|'
    rb'^\{("truncated": true, )?"shape": \[(\d+, ){2}\d+\]'
)
_LONGEST_TEXT = 1 << 16


@dataclass(frozen=True)
class _Layout:
    """Types and sizes of the numbers that lead through a file: TIFF, or BigTIFF."""

    order: str
    big: bool

    @property
    def offset(self) -> str:
        return f"{self.order}u{8 if self.big else 4}"

    @property
    def count(self) -> str:
        return f"{self.order}u{8 if self.big else 2}"

    @property
    def tag(self) -> np.dtype:
        short = f"{self.order}u2"
        return np.dtype(
            [("code", short), ("type", short), ("length", self.offset), ("value", self.offset)]
        )


def holds_stack(path: Path) -> bool:
    """Return True for a TIFF file of more than one picture, thumbnails left out.

    A damaged one counts: what is wrong is told when it is read.
    """
    try:
        pictures, first = _walk(path, enough=2)
        return pictures > 1 or first
    except (OSError, FileFormatError):
        return True


def check_chain(path: Path) -> None:
    """Check that the chain of directories is whole."""
    _walk(path)


def _walk(path: Path, enough: int = 0) -> tuple[int, bool]:
    """Return the number of pictures (or `enough`), and whether the first stands for a stack."""
    size, pictures, stack = path.stat().st_size, 0, False
    seen: set[int] = set()
    with open(path, "rb") as file:
        layout = _Layout("<" if file.read(2) == b"II" else ">", file.read(2) in (b"+\0", b"\0+"))
        file.seek(8 if layout.big else 4)
        at = int(_read(file, layout.offset, size)[0])
        while at:
            if at in seen or at >= size:
                raise FileFormatError(
                    f"{path.name} is cut short or damaged: picture {len(seen) + 1} should begin at "
                    f"byte {at} of {size}"
                )
            seen.add(at)
            file.seek(at)
            tags = _read(file, layout.tag, size, int(_read(file, layout.count, size)[0]))
            at = int(_read(file, layout.offset, size)[0])
            _check_values(tags, layout, size)
            stack = stack or (len(seen) == 1 and _is_stack(file, tags, layout))
            pictures += not _is_reduced(tags, layout)
            if enough and pictures >= enough:
                break
    return pictures, stack


def _read(file: IO[bytes], dtype: np.dtype | str, size: int, count: int = 1) -> np.ndarray:
    dtype = np.dtype(dtype)
    if count * dtype.itemsize > size:
        raise FileFormatError(f"a directory claims {count} tags, more than the file can hold")
    data = file.read(count * dtype.itemsize)
    if len(data) < count * dtype.itemsize:
        raise FileFormatError(f"it is cut short: a directory should go on at byte {file.tell()}")
    return np.frombuffer(data, dtype)


def _check_values(tags: np.ndarray, layout: _Layout, size: int) -> None:
    public = tags[(tags["code"] < _FIRST_PRIVATE) & (tags["type"] < len(_TYPE_SIZES))]
    lengths = public["length"].astype(float) * _TYPE_SIZES[public["type"]]
    elsewhere = lengths > np.dtype(layout.offset).itemsize
    ends = public["value"].astype(float) + lengths
    if np.any(ends[elsewhere] > size):
        raise FileFormatError(
            f"it is cut short or damaged: tags point to byte {ends[elsewhere].max():.0f} of {size}"
        )


def _value(tags: np.ndarray, code: int, layout: _Layout) -> int:
    """Return a small number that is in the tag itself; zero if there is none."""
    found = tags[tags["code"] == code]
    if not len(found):
        return 0
    short = found["type"][0] == 3
    return int(found["value"][:1].view(f"{layout.order}u2")[0] if short else found["value"][0])


def _is_reduced(tags: np.ndarray, layout: _Layout) -> bool:
    return bool(_value(tags, _SUBFILE, layout) & _REDUCED)


def _is_stack(file: IO[bytes], tags: np.ndarray, layout: _Layout) -> bool:
    if _value(tags, _DEPTH, layout) > 1:
        return True
    text = tags[tags["code"] == _DESCRIPTION]
    if not len(text):
        return False
    before = file.tell()
    file.seek(int(text["value"][0]))
    found = _STACK.search(file.read(min(int(text["length"][0]), _LONGEST_TEXT)))
    file.seek(before)
    return found is not None


STACK_OPTIONS = {
    "spacing": "width of the voxels, or one per axis x, y, z; by default what the file tells",
    "unit": "unit of length",
}
# Packings that need nothing else: none, Deflate, PackBits.
_UNPACKED_HERE = (1, 8, 32946, 32773)
# Deflate, the best packer among them, makes data at most 1032 times smaller.
_MOST_PACKED = 1032


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a file; of a set of files this one only, and without a word about odd tags."""
    import tifffile

    logger = logging.getLogger("tifffile")
    before, logger.disabled = logger.disabled, True
    try:
        with tifffile.TiffFile(path, _multifile=False) as file:
            yield file
    finally:
        logger.disabled = before


def cells_from_zero(shape: tuple[int, ...], spacing: Any, unit: Any) -> Placement:
    """Return the placement of cells that begin at 0, as in other files of arrays."""
    grid = equal_cells(shape, {"spacing": spacing}, unit)
    widths = np.ptp(grid.bounds, axis=1) / grid.shape
    return Placement(widths / 2, np.diag(widths), grid.describe()["unit"])


def single_picture(path: Path) -> np.ndarray:
    """Return the first picture of a file, shape (rows, columns) or (rows, columns, samples)."""
    with opened(path) as file:
        page = file.pages.first
        _check_pages(path, [page])
        if page.axes not in ("YX", "YXS"):
            raise FileFormatError(f"expected a picture with rows and columns, got {page.axes}")
        return page.asarray()


def part_of(path: Path, file: Any, number: int, index: tuple[Any, ...]) -> np.ndarray:
    """Return part of a series; only the pictures needed are read."""
    series = file.series[number]
    if series.dataoffset is not None:
        dtype = np.dtype(series.dtype).newbyteorder(file.byteorder)
        return mapped(path, series.dataoffset, series.shape, dtype)[index]
    outer = _outer_axes(series)
    numbers = np.arange(len(series.pages)).reshape(series.shape[:outer])[index[:outer]]
    pages = [series.pages[k] for k in np.ravel(numbers)]
    _check_pages(path, pages)
    values = file.asarray(key=[int(k) for k in np.ravel(numbers)], series=number)
    values = values.reshape(*np.shape(numbers), *series.shape[outer:])
    return values[(slice(None),) * np.ndim(numbers) + index[outer:]]


def _outer_axes(series: Any) -> int:
    for outer in range(len(series.shape)):
        if math.prod(series.shape[:outer]) == len(series.pages):
            return outer
    raise FileFormatError(
        f"expected pictures for the shape {series.shape}, found {len(series.pages)}"
    )


def _check_pages(path: Path, pages: list[Any]) -> None:
    if any(page is None for page in pages):
        raise FileFormatError("some of its pictures are missing: they are in other files")
    first, found = pages[0].keyframe, path.stat().st_size
    if first.compression not in _UNPACKED_HERE or first.predictor == 3:
        require("imagecodecs", "tiff", f"unpacking TIFF ({first.compression.name})")
    needed = math.prod(first.chunked)
    for number, page in enumerate(pages):
        ends = [a + n for a, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
        if len(ends) < needed or max(ends) > found:
            raise FileFormatError(
                f"{path.name} is cut short: {found} bytes, but picture {number + 1} ends at byte "
                f"{max(ends, default=0)} with {len(ends)} of {needed} strips or tiles"
            )
    size = max(math.prod(first.shape), math.prod(first.chunks) * needed) * first.dtype.itemsize
    if size > max(_MOST_PACKED * found, 1 << 24):
        raise FileFormatError(f"{found} bytes cannot hold pictures of {size} bytes each")


_RESOLUTIONS = ("XResolution", "YResolution")


def scale_of(file: Any, number: int) -> tuple[tuple[float, ...], str]:
    """Return the widths of voxels along x, y, z and their unit; (1, 1, 1) where it is not told."""
    if file.is_ome and file.ome_metadata:
        return _ome(_pixels(file, number))
    if file.is_imagej and file.imagej_metadata:
        return _imagej(file)
    # Other files tell the size of paper at best.
    return (1.0, 1.0, 1.0), ""


def channels_of(file: Any, number: int, count: int) -> list[Channel]:
    """Return the entries of so many channels of a series, empty where the file gives nothing."""
    listed = []
    if file.is_ome and file.ome_metadata:
        listed = [_ome_channel(e.attrib) for e in _pixels(file, number) if _tag(e) == "Channel"]
    elif file.is_imagej and file.imagej_metadata:
        listed = _imagej_channels(file.imagej_metadata, count)
    return (listed + [{}] * count)[:count]


def _pixels(file: Any, number: int) -> ElementTree.Element:
    """Return OME's description of a series, which are in the order of the images."""
    root = ElementTree.fromstring(file.ome_metadata)
    found = [e for e in root.iter() if _tag(e) == "Pixels"]
    return found[number] if number < len(found) else ElementTree.Element("Pixels")


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rsplit("}", 1)[-1]


def _ome_channel(told: Mapping[str, str]) -> Channel:
    try:
        color = list((int(told["Color"]) % 2**32).to_bytes(4, "big")[:3])
    except (KeyError, ValueError):
        color = None
    return channel(told.get("Name") or told.get("Fluor"), color)


def _imagej_channels(notes: Mapping[str, Any], count: int) -> list[Channel]:
    """Return colours, of tables that go from black to one colour evenly, and display ranges."""
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


def _ome(element: ElementTree.Element) -> tuple[tuple[float, ...], str]:
    pixels = element.attrib
    sizes = [pixels.get(f"PhysicalSize{axis}") for axis in "XYZ"]
    if not any(sizes):
        return (1.0, 1.0, 1.0), ""
    units = [length_unit(pixels.get(f"PhysicalSize{axis}Unit", "um")) for axis in "XYZ"]
    widths = [
        float(size) * conversion(unit, units[0]) if size else None
        for size, unit in zip(sizes, units, strict=True)
    ]
    known = [width for width in widths if width]
    # Of what is not told it is most likely that voxels are cubes.
    return tuple(width or known[0] for width in widths), units[0]


def _imagej(file: Any) -> tuple[tuple[float, ...], str]:
    notes, tags = file.imagej_metadata, file.pages.first.tags
    unit = length_unit(str(notes.get("unit", "")))
    widths = []
    for name in _RESOLUTIONS:
        over, under = tags.valueof(name, (1, 1))
        # Without a unit of length resolutions are what a printer is to do.
        widths.append(under / over if unit and over and under else 1.0)
    depth = float(notes.get("spacing", 0)) if unit or "spacing" in notes else 0.0
    return (*widths, abs(depth) or widths[0]), unit


# What becomes the third axis of a volume, the first that there is: z; pictures one after the other;
# time or channels, as stacks of slices are called by those who did not say what they are.
_THIRD = "ZIQTC"


class TIFFReader(VoxelReader):
    """A stack of pictures of one size: columns are x, rows y (downwards), pictures z."""

    name = "tiff"
    description = "a TIFF stack (.tif with several pictures)"
    suffixes = (".tif", ".tiff")
    options = {  # noqa: RUF012 - as in Reader
        **VoxelReader.options,
        **STACK_OPTIONS,
        "time": "number of the time step, from 0, of a file with several",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return head.startswith(MAGICS)

    def holds_image(self, path: Path) -> bool:
        return not holds_stack(path)

    def voxels(self, path: Path, *, spacing: Any = None, unit: Any = None, time: int = 0) -> Voxels:
        check_chain(path)
        with opened(path) as file:
            number, series = _stack(file)
            sizes = _sizes(series)
            third = _third(sizes)
            widths, own = scale_of(file, number)
            listed = channels_of(file, number, sizes.get("C", 1))
            if third == "C":
                _check_slices(listed)
            dtype = np.dtype(series.dtype)
        times = sizes.get("T", 1) if third != "T" else 1
        step = time_step(time, times)
        channels = sizes.get("C", 1) if third != "C" else 1
        samples = sizes.get("S", 1)
        count = channels * samples

        def load(component: int) -> np.ndarray:
            channel, sample = divmod(component, samples)
            chosen = {"T": step, "C": channel, "S": sample}
            return _tiff_read(path, number, {k: n for k, n in chosen.items() if k != third}, third)

        shape = (sizes["X"], sizes["Y"], sizes[third])
        return Voxels(
            shape=shape,
            dtype=np.dtype(np.float32) if dtype == np.float16 else dtype.newbyteorder("="),
            placement=cells_from_zero(shape, widths if spacing is None else spacing, unit or own),
            load=load,
            components=("",) if count == 1 else components(count, COLORS if channels == 1 else ()),
            channels=of_samples(samples) * channels if samples > 1 else listed[:channels],
            meta=Y_DOWN | ({} if times == 1 else {"times": times, "time_step": step}),
        )


def _check_slices(listed: list[Channel]) -> None:
    names = [str(entry.get("label", "?")) for entry in listed]
    if any({"label", "color"} & entry.keys() for entry in listed):
        raise FileFormatError(
            f"expected a stack of pictures, got one of {len(names)} channels ({', '.join(names)}): "
            "an image is no volume"
        )


def _stack(file: Any) -> tuple[int, Any]:
    for number, series in enumerate(file.series):
        if _third(_sizes(series)):
            return number, series
    listed = ", ".join(f"{s.axes} {s.shape}" for s in file.series)
    raise FileFormatError(
        f"expected a stack of pictures, got axes {listed or 'of nothing'}: an image is no volume"
    )


def _sizes(series: Any) -> dict[str, int]:
    """Return the sizes of the axes that have any."""
    pairs = zip(series.axes, series.shape, strict=True)
    kept = [(axis, int(n)) for axis, n in pairs if n != 1 or axis in "XY"]
    sizes = dict(kept)
    third = _third(sizes)
    strange = set(sizes) - {*"XYTCS", third} or len(sizes) < len(kept)
    if third and (strange or not set("XY") <= set(sizes) or min(sizes.values()) < 1):
        raise FileFormatError(
            "expected axes X, Y, Z (or one unnamed), and perhaps channels C, samples S and time T, "
            f"got {series.axes} {series.shape}; write the stack with names for its axes"
        )
    return sizes


def _third(sizes: dict[str, int]) -> str:
    return next((axis for axis in _THIRD if axis in sizes), "")


def _tiff_read(path: Path, number: int, chosen: dict[str, int], third: str) -> np.ndarray:
    with opened(path) as file:
        series = file.series[number]
        index = tuple(chosen.get(axis, slice(None)) for axis in series.axes)
        values = part_of(path, file, number, index)
        left = [a for a, k in zip(series.axes, index, strict=True) if isinstance(k, slice)]
    # Axes of size one that mean nothing may be left.
    order = [left.index(axis) for axis in ("X", "Y", third)]
    order += [k for k in range(len(left)) if k not in order]
    return values.transpose(order).reshape([values.shape[k] for k in order[:3]])


_TIFF = (".tif", ".tiff")
_SUFFIXES = (*_TIFF, ".png")
# What lies beside slices, and says how they were made.
_NOTES = ("", ".txt", ".log", ".xml", ".json", ".csv", ".ini", ".md", ".db", ".info")
_NUMBER = re.compile(r"(\d+)")
_PNG_END = b"IEND\xaeB`\x82"
# Kinds of pixels whose numbers are values, as Pillow calls them.
_MODES = ("1", "L", "LA", "I", "I;16", "I;16B", "F", "RGB", "RGBA")
_BRIGHTNESS = ("_0", "_alpha")


class PicturesReader(VoxelReader):
    """Pictures of one size and kind, sorted by the numbers in their names."""

    name = "pictures"
    description = "a directory of numbered pictures (.tif, .png), one per slice"
    options = {**VoxelReader.options, **STACK_OPTIONS}  # noqa: RUF012 - as in Reader

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
            return out.transpose()

        return Voxels(
            shape=shape,
            dtype=first.dtype.newbyteorder("="),
            placement=cells_from_zero(shape, 1.0 if spacing is None else spacing, unit),
            load=load,
            components=("",)
            if samples == 1
            else components(samples, COLORS if samples > 2 else _BRIGHTNESS),
            name=path.resolve().name,
            channels=of_samples(samples),
            meta=Y_DOWN,
        )


def _slices(directory: Path) -> list[Path]:
    """Return the pictures of a directory, in the order of their numbers; none if it is another."""
    with os.scandir(directory) as entries:
        names = [e.name for e in entries if not e.name.startswith(".") and e.is_file()]
    found = [n for n in names if n.lower().endswith(_SUFFIXES) and _NUMBER.search(Path(n).stem)]
    others = {Path(name).suffix.lower() for name in names if name not in found}
    kinds = {_NUMBER.sub("#", name) for name in found}
    if len(kinds) != 1 or not others <= set(_NOTES):
        return []
    return [directory / name for name in sorted(found, key=_numbers)]


def _numbers(name: str) -> list[int]:
    return [int(number) for number in _NUMBER.findall(name)]


def _picture(path: Path) -> np.ndarray:
    with reading(path, "a picture"):
        values = _tiff(path) if path.suffix.lower() in _TIFF else _png(path)
    return values if values.ndim == 3 else values[..., None]


def _tiff(path: Path) -> np.ndarray:
    check_chain(path)
    return single_picture(path)


def _png(path: Path) -> np.ndarray:
    from PIL import Image

    with open(path, "rb") as file:
        file.seek(-min(64, path.stat().st_size), os.SEEK_END)
        if _PNG_END not in file.read():
            raise FileFormatError("it is cut short: the end of a PNG file is missing")
    with Image.open(path) as picture:
        if picture.mode not in _MODES:
            raise FileFormatError(f"expected pixels that are values, got the mode {picture.mode!r}")
        return np.asarray(picture)
