"""The first picture of a large volume, in a process of its own: processor time and peak memory.

    python benchmarks/large_first_picture.py            # 512³ numbers, in memory
    python benchmarks/large_first_picture.py --octets   # 1024³ of 8 bits, from a .npy

Kernels are compiled where the cache on disk lacks them: run it twice for the time without that.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

KINDS: dict[str, dict[str, Any]] = {
    "first order": {"scheme": "first-order"},
    "tolerance=None": {"tolerance": None},
    "default": {},
}


def fill(path: Path, octets: bool) -> None:
    """Write a field: waves in a sphere whose density falls over six decades, or shells."""
    n = 1024 if octets else 512
    x = np.linspace(-1, 1, n, dtype=np.float32)
    kind = np.uint8 if octets else np.float32
    out = np.lib.format.open_memmap(path, "w+", kind, (n, n, n))
    for i in range(n):
        square = x[i] ** 2 + x[:, None] ** 2 + x**2
        waves = np.sin(5 * x[i] + 4 * x[:, None] - 3 * x) + np.sin(6 * x - 2 * x[i])
        if octets:
            shell = np.exp(-(((np.sqrt(square) - 0.7) / 0.05) ** 2))
            out[i] = (220 * shell + 8 * (1 + waves / 2)).astype(np.uint8)
        else:
            out[i] = 10 ** (2 - 3 * square + 0.5 * waves)
    out.flush()


def draw(path: str, kind: str) -> None:
    """Draw one picture, and print what it took."""
    import voluminous as vm

    volume: Any = vm.open(path)
    (name,) = volume.fields
    if not path.endswith("octets.npy"):
        array = np.load(path)
        volume = vm.Volume(vm.CartesianGrid.uniform(array.shape[0], (-1, 1)), {name: array})
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    expr, center, sigma = (name, 120, 8) if path.endswith("octets.npy") else (None, 1, 0.1)
    medium = vm.Gaussian(expr or f"log10({name})", center, sigma, (0.9, 0.5, 0.1), 0.3, "auto")
    start, wall = time.process_time(), time.perf_counter()
    if kind == "all defaults":
        vm.render(volume)
    else:
        camera = vm.Orthographic(60, 30, resolution=800)
        vm.render(volume, medium, camera, **KINDS[kind])
    took, passed = time.process_time() - start, time.perf_counter() - wall
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    cells = f"{passed:6.1f} s, {took:6.1f} s of a processor, peak {peak / 2**20:.2f} GiB"
    print(f"{kind:15} {cells} ({before / 2**20:.2f} before)", flush=True)


def main() -> None:
    """Write the field, and draw each kind of picture in another process."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--octets", action="store_true", help="1024³ cells of 8 bits")
    parser.add_argument("--draw", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.draw:
        draw(*options.draw)
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / ("octets.npy" if options.octets else "numbers.npy")
        fill(path, options.octets)
        for kind in (*KINDS, "all defaults"):
            subprocess.run([sys.executable, __file__, "--draw", str(path), kind], check=True)


if __name__ == "__main__":
    main()
