"""Measure one picture drawn by several processes (``executor=``) beside one that draws it alone.

    python benchmarks/workers.py big.zarr --workers 1 2 --threads 1

Processes are those of Dask's LocalCluster, each with so many threads. Told are the wall time of the
second picture (the first one compiles), the processor time of all processes together and of the one
that asks alone, and how many tasks there were.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from distributed import Client, LocalCluster

import voluminous as vm


def set_threads(count: int) -> None:
    """Let kernels of this process run on so many threads."""
    from voluminous.backend import dr

    dr.set_thread_count(count)


def main() -> None:
    """Print a line for each number of processes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("path", type=Path)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--pixels", type=int, default=800)
    parser.add_argument("--scheme", default="first-order")
    parser.add_argument("--memory", default="1 GiB")
    args = parser.parse_args()
    volume = vm.open(args.path)
    name = volume.fields[0]
    low, high = (float(f(volume.store.extremes(name))) for f in (np.min, np.max))
    medium = vm.Gaussian(
        name, low + 0.6 * (high - low), 0.05 * (high - low), "orange", opacity=0.5, path_length=0.1
    )
    width = 1.8 * float(np.ptp(volume.grid.bounds[0]))
    camera = vm.Orthographic(60, 30, width=width, resolution=args.pixels)
    options: dict[str, Any] = {"scheme": args.scheme, "memory": args.memory, "progress": False}
    set_threads(args.threads)
    picture = None
    for count in (0, *args.workers):
        if not count:
            first, tell = draw(volume, medium, camera, options, None)
            picture = first.intensity
        else:
            with (
                LocalCluster(
                    n_workers=count, threads_per_worker=1, dashboard_address=None
                ) as cluster,
                Client(cluster) as client,
            ):
                client.run(set_threads, args.threads)
                image, tell = draw(volume, medium, camera, options, client)
                assert np.array_equal(image.intensity, picture)
        print(f"{count or 'no'} workers: {tell}", flush=True)


def draw(
    volume: Any, medium: Any, camera: Any, options: dict[str, Any], client: Any
) -> tuple[Any, str]:
    """Return a picture, and the times that its second drawing took."""
    vm.render(volume, medium, camera, executor=client, **options)
    workers = processor_times(client)
    start, own = time.perf_counter(), time.process_time()
    image = vm.render(volume, medium, camera, executor=client, **options)
    wall, own = time.perf_counter() - start, time.process_time() - own
    others = processor_times(client) - workers
    return image, f"{wall:.2f} s, processors {own + others:.2f} s (of which here {own:.2f})"


def processor_times(client: Any) -> float:
    """Return the processor time that the workers have taken."""
    return 0.0 if client is None else sum(client.run(lambda: sum(os.times()[:2])).values())


if __name__ == "__main__":
    main()
