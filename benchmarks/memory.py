"""Measure the memory of a render beside volume plus coefficients (asked: at most 20 % more).

    python benchmarks/memory.py --cells 256 512

Each size runs in its own process. The baseline is what the process holds after a tiny render of the
same kind: Python, the libraries and the compiled kernel. The peak above it is compared with

* volume: one float32 per cell, and
* coefficients: three emissivities and one grey extinction per cell, float32.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil

from scenes import SCENES
from timing import table

TINY = 16
FLOAT = 4  # bytes
COEFFICIENTS = 4  # three emissivities, one extinction
SCHEMES = ("first-order", "second-order")
# ru_maxrss is in KiB on Linux, in bytes on macOS.
MAXRSS_UNIT = 1 if sys.platform == "darwin" else 1024


def peak_of_render(cells: int, scheme: str) -> int:
    """Return the bytes by which this process' peak exceeds what it held before building a scene."""
    from our_scene import OurScene

    OurScene(replace(SCENES["core"], cells=TINY), scheme).draw()
    # What is held now, not the peak until now: memory that compiling used and gave back is free
    # for the render, and counting it in the baseline would flatter us.
    baseline = psutil.Process().memory_info().rss
    OurScene(replace(SCENES["core"], cells=cells), scheme).draw()
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * MAXRSS_UNIT - baseline


def measure(cells: int, scheme: str) -> dict[str, Any]:
    """Return the numbers of one size and scheme, measured in a process of its own."""
    command = [sys.executable, __file__, "--child", scheme, "--cells", str(cells)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    volume = FLOAT * cells**3
    peak = int(done.stdout)
    return {
        "cells": cells,
        "scheme": scheme,
        "peak_bytes": peak,
        "volume_bytes": volume,
        "ratio_to_volume": peak / volume,
        "ratio": peak / (volume * (1 + COEFFICIENTS)),
    }


def report(results: Sequence[dict[str, Any]]) -> str:
    """Return the table."""
    header = ["", "peak MiB", "volume MiB", "peak / volume", "peak / (volume + coefficients)"]
    rows = [
        [
            f"{r['cells']}^3 {r['scheme']}",
            f"{r['peak_bytes'] / 2**20:.0f}",
            f"{r['volume_bytes'] / 2**20:.0f}",
            f"{r['ratio_to_volume']:.2f}",
            f"{r['ratio']:.2f}",
        ]
        for r in results
    ]
    return table(header, rows)


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", type=int, nargs="+", default=[256, 512])
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    parser.add_argument("--child", choices=SCHEMES, help=argparse.SUPPRESS)
    return parser.parse_args()


def main() -> None:
    """Measure each size and scheme and print; as a child, print one number of bytes."""
    options = parse()
    if options.child:
        print(peak_of_render(options.cells[0], options.child))
        return
    results = [measure(cells, scheme) for cells in options.cells for scheme in SCHEMES]
    print(report(results))
    if options.json:
        options.json.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
