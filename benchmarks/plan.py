"""How true plans are: pictures drawn chunk by chunk, and what `vm.plan` said of them.

``python benchmarks/plan.py FIELD STORE...`` with stores of a field that ``voluminous convert
--stats`` wrote. Processor seconds say more than those of the clock where other work is done.
"""

from __future__ import annotations

import itertools
import sys
import time

import numpy as np

import voluminous as vm

CASES = [("first-order", 200), ("first-order", 800), ("pre-integrated", 400)]
CASES += [("post-classified", 200), ("post-classified", 600)]


def main(name: str, paths: list[str]) -> None:
    """Print a line for each picture."""
    for path, (scheme, pixels), memory in itertools.product(paths, CASES, ("512 MB", "2 GB")):
        volume = vm.open(path)
        low, high = np.quantile(volume.store.extremes(name), (0.2, 0.8))
        thick = float(np.ptp(volume.grid.bounds[0])) / 10
        width = 0.1 * float(high - low)
        medium = vm.Gaussian(name, float(high), width, "orange", 0.5, path_length=thick)
        camera = vm.Orthographic(35, 25, resolution=pixels)
        options = {"memory": memory, "scheme": scheme}
        try:
            said = vm.plan(volume, medium, camera, **options)
        except vm.errors.MemoryNeededError:
            continue
        wall, busy = time.perf_counter(), time.process_time()
        vm.render(volume, medium, camera, **options)
        busy, wall = time.process_time() - busy, time.perf_counter() - wall
        print(
            f"{path.rsplit('/')[-1]:12} {scheme:16} {pixels:4} {memory:7} boxes {said.boxes:4} "
            f"said {said.seconds:6.1f} s, processor {busy:6.1f} s, clock {wall:6.1f} s",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
