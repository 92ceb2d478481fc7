"""Measure drawing chunk by chunk (``memory=``) beside drawing the whole volume.

    python benchmarks/streaming.py --cells 512 --memory "500 MiB"
    python benchmarks/streaming.py --cells 1024 --memory "512 MiB" --only streamed

Turbulence-like values around a peak, in chunks of 128³ (Zarr; packed by zstd, lz4 or not) with
their ranges unknown, or flat (.npy). What is drawn chunk by chunk is in the file, or was loaded
before: that tells what reading and unpacking cost. Three shells, 800×800 pixels. Each
picture is drawn in a process of its own: the time of the first picture and of the next one, and the
peak of the memory above what the process held after a tiny picture of the same kind. Times are of
the processor (both cores) and of the wall.
"""

from __future__ import annotations

import argparse
import functools
import json
import operator
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil

import voluminous as vm

CHUNK, COARSE, LAYERS = 128, 17, 64
SHELLS = [(0.0, 0.05, "orange", 0.4), (0.7, 0.05, "skyblue", 0.8), (1.2, 0.1, "lime", 1.0)]


def write(path: Path, cells: int, kind: str) -> None:
    """Write cells³ numbers, layers by layers."""
    place = (np.arange(cells) + 0.5) / cells
    noise = np.random.default_rng(1).normal(size=(COARSE,) * 3)
    noise = along(along(noise, 1, place), 2, place)
    if kind == "npy":
        out: Any = np.lib.format.open_memmap(path, "w+", np.float32, (cells,) * 3)
    else:
        import zarr
        from zarr.codecs import BloscCodec

        out = zarr.open_group(path, mode="w").create_array(
            "a",
            shape=(cells,) * 3,
            chunks=(CHUNK,) * 3,
            dtype="f4",
            compressors=None if kind == "plain" else BloscCodec(cname=kind, shuffle="bitshuffle"),
        )
    square = (2 * place - 1) ** 2
    step = LAYERS if kind == "npy" else CHUNK
    for first in range(0, cells, step):
        own = slice(first, first + step)
        r2 = square[own, None, None] + square[:, None] + square
        out[own] = 0.3 * along(noise, 0, place[own]) - np.log10(0.02 + r2)


def along(values: np.ndarray, axis: int, place: np.ndarray) -> np.ndarray:
    """Return values interpolated along an axis, at places from 0 to 1."""
    low = np.minimum((place * (COARSE - 1)).astype(int), COARSE - 2)
    part = (place * (COARSE - 1) - low).reshape([-1 if a == axis else 1 for a in range(3)])
    first, last = values.take(low, axis), values.take(low + 1, axis)
    return (first + part * (last - first)).astype(np.float32)


def peak() -> int:
    """Return the most memory that this process has held (Linux).

    What getrusage tells includes the parent's.
    """
    status = Path("/proc/self/status").read_text().splitlines()
    return int(next(line.split()[1] for line in status if line.startswith("VmHWM"))) << 10


def draw(path: Path, loaded: bool, options: dict[str, Any]) -> dict[str, float]:
    """Return seconds of two pictures, and the peak of the memory they took."""
    volume = vm.open(path)
    if loaded:
        volume.load()
    width = float(np.ptp(volume.grid.bounds[0]))
    shells = [
        vm.Gaussian("a", *shell, path_length=0.05 * width)  # type: ignore[arg-type]
        for shell in SHELLS
    ]
    medium = functools.reduce(operator.add, shells)
    camera = vm.Orthographic(35, 25, width=1.5 * width, resolution=800)
    tiny = vm.Volume(vm.CartesianGrid.uniform(16, (0, 16)), a="x/16")
    vm.render(tiny, medium, camera.replace(width=24, resolution=32), **options)
    before, told = psutil.Process().memory_info().rss, {}
    for name in ("first", "next"):
        wall, cpu = time.perf_counter(), time.process_time()
        vm.render(volume, medium, camera, **options)
        told[f"{name} wall s"] = time.perf_counter() - wall
        told[f"{name} cpu s"] = time.process_time() - cpu
    told["peak MiB"] = (peak() - before) / 2**20
    return told


def main() -> None:
    """Write the volume, and measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=256)
    parser.add_argument("--memory", default="500 MiB")
    parser.add_argument("--only", choices=("streamed", "loaded", "whole"))
    parser.add_argument("--kind", choices=("zstd", "lz4", "plain", "npy"), default="zstd")
    parser.add_argument("--scheme", choices=("first-order", "post-classified"))
    parser.add_argument("--tolerance", type=float, default=1e-3)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--child", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child:
        path, how, options = json.loads(args.child)
        print(json.dumps(draw(Path(path), how == "loaded", options)))
        return
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / ("big.npy" if args.kind == "npy" else "big.zarr")
        write(path, args.cells, args.kind)
        for scheme in [args.scheme] if args.scheme else ["first-order", "post-classified"]:
            for how in [args.only] if args.only else ["streamed", "loaded", "whole"]:
                options = {"scheme": scheme, "tolerance": args.tolerance}
                if how != "whole":
                    options["memory"] = args.memory
                child = json.dumps([str(path), how, options])
                command = [sys.executable, __file__, "--child", child]
                told = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
                rows.append({"scheme": scheme, "how": how, **json.loads(told.stdout)})
                print({k: v if isinstance(v, str) else round(v, 2) for k, v in rows[-1].items()})
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
