"""Time and memory of placing particles on a grid.

    python benchmarks/particles.py
    python benchmarks/particles.py --counts 1e5 1e6 --kinds smoothed mesh

Each case runs in a process of its own, so that the largest memory is its own. Processor time is
printed beside the time that passed: the first is what load from elsewhere changes least.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time

import numpy as np

import voluminous as vm
from timing import table

KINDS = ("smoothed", "mesh", "neither", "clustered")


def options_of(kind: str, points: np.ndarray, spacing: np.ndarray) -> dict[str, np.ndarray]:
    """Return what tells how large particles are."""
    if kind == "neither":
        return {}
    return {"volume": spacing**3} if kind == "mesh" else {"smoothing_length": 1.2 * spacing}


def particles(kind: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and mean distances: uniform, or a Gaussian for "clustered"."""
    rng = np.random.default_rng(1)
    if kind != "clustered":
        return rng.random((count, 3)), np.full(count, count ** (-1 / 3))
    points = rng.normal(size=(count, 3))
    number = count * np.exp(-0.5 * (points**2).sum(axis=1)) / (2 * np.pi) ** 1.5
    return points, np.minimum(number ** (-1 / 3), 1.0)


def run(kind: str, count: int) -> None:
    """Place particles and print cells, seconds passed, processor seconds and memory."""
    points, spacing = particles(kind, count)
    vm.Volume.from_particles(points[:100], 1.0, **options_of(kind, points[:100], spacing[:100]))
    passed, busy = time.perf_counter(), time.process_time()
    volume = vm.Volume.from_particles(
        points, 1.0, fields={"velocity": points}, **options_of(kind, points, spacing)
    )
    passed, busy = time.perf_counter() - passed, time.process_time() - busy
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(volume.grid.size, f"{passed:.2f}", f"{busy:.2f}", f"{memory:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--counts", nargs="+", type=float, default=[1e5, 1e6])
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--one", action="store_true", help="the first case, in this process")
    args = parser.parse_args()
    if args.one:
        return run(args.kinds[0], int(args.counts[0]))
    rows = []
    for kind in args.kinds:
        for count in args.counts:
            command = [sys.executable, __file__, "--one", "--kinds", kind, "--counts", str(count)]
            told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            rows.append([kind, f"{count:.0e}", *told.split()])
    print(table(["kind", "particles", "cells", "seconds", "processor s", "GiB"], rows))


if __name__ == "__main__":
    main()
