"""TIFF stacks: microscopes (OME-TIFF), ImageJ, micro-CT; BigTIFF too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ..channels import Y_DOWN, Channel, of_samples
from .tiff_chain import MAGICS, check_chain, holds_stack
from .tiff_pages import STACK_OPTIONS, cells_from_zero, opened, part_of
from .tiff_scale import channels_of, scale_of
from .voxels import COLORS, VoxelReader, Voxels, components, time_step

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
            return _read(path, number, {k: n for k, n in chosen.items() if k != third}, third)

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
    """Return the sizes of the axes that have any.

    Raises
    ------
    FileFormatError
        If one has an unknown meaning.
    """
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


def _read(path: Path, number: int, chosen: dict[str, int], third: str) -> np.ndarray:
    with opened(path) as file:
        series = file.series[number]
        index = tuple(chosen.get(axis, slice(None)) for axis in series.axes)
        values = part_of(path, file, number, index)
        left = [a for a, k in zip(series.axes, index, strict=True) if isinstance(k, slice)]
    # Axes of size one that mean nothing may be left.
    order = [left.index(axis) for axis in ("X", "Y", third)]
    order += [k for k in range(len(left)) if k not in order]
    return values.transpose(order).reshape([values.shape[k] for k in order[:3]])
