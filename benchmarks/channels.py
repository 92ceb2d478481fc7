"""Print what a picture of a spectrum costs, from 3 to 100 channels, in each scheme.

    python benchmarks/channels.py --channels 3 10 40 100
    python benchmarks/channels.py --scene dust --channels 10
    python benchmarks/channels.py --scene co --channels 40 400

Dust with its own extinction in each channel, as `Coefficients`, on 64³ cells, seen by 200² pixels;
or what RADMC-3D was timed with: a disc of `vm.Dust`, or `vm.Lines` of CO.
Each case is a process of its own, without compiled kernels: the first picture compiles them.
Memory is the peak above that of the process before the picture. Times are wall times, and
(in brackets) processor times over the number of cores, which other load disturbs less.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from timing import table

SCHEMES = ("first-order", "second-order", "pre-integrated", "post-classified")


def measure(channels: int, scheme: str, repeats: int, scene: str) -> dict[str, float]:
    """Return times in seconds and memory in MB of pictures in this process.

    Each picture of dust and lines has a camera of its own.
    """
    import voluminous as vm

    made = {"coefficients": coefficients, "dust": dust, "co": carbon_monoxide}[scene](channels)
    small = vm.models.uniform_slab(emissivity=1.0, extinction=1.0, thickness=1.0)
    vm.render(small, vm.Coefficients("j", "a"), vm.Orthographic(resolution=8), scheme="first-order")
    before = _resident()
    first = _timed(lambda: made(0, scheme))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    warm = [_timed(lambda k=k: made(k, scheme)) for k in range(1, 1 + repeats)]
    (wall, cpu), (again, used) = first, np.min(warm, axis=0)
    return {"first": wall, "first_cpu": cpu, "warm": again, "warm_cpu": used, "MB": peak - before}


def coefficients(channels: int) -> Callable[[int, str], object]:
    """Return what draws dust with an extinction for each channel, as expressions."""
    import voluminous as vm

    edges = np.linspace(-1.0, 1.0, 65)
    x, y, z = np.meshgrid(*[0.5 * (edges[1:] + edges[:-1])] * 3, indexing="ij")
    square = x**2 + y**2 + z**2
    density = np.exp(-3.0 * square) * (1.0 + 0.3 * np.sin(7.0 * x) * np.cos(5.0 * y + 3.0 * z))
    temperature = 20.0 + 30.0 * np.exp(-2.0 * square) * (1.0 + 0.2 * np.cos(6.0 * z))
    volume = vm.Volume(vm.CartesianGrid(edges, edges, edges), rho=density, T=temperature)
    opacity = np.linspace(0.3, 2.0, channels).tolist()
    rows = zip(opacity, np.linspace(10.0, 100.0, channels).tolist(), strict=True)
    medium = vm.Coefficients(
        [f"{k!r} * rho / (exp({h!r} / T) - 1)" for k, h in rows], [f"{k!r} * rho" for k in opacity]
    )
    camera = vm.Orthographic(30, 40, width=2.6, resolution=200)
    return lambda _, scheme: vm.render(volume, medium, camera, scheme=scheme)


def dust(channels: int) -> Callable[[int, str], object]:
    """Return what draws a disc of dust, 100³ cells, at 400² pixels."""
    import voluminous as vm

    volume = disc(100)
    medium = vm.Dust("n * 1e-19", "T", vm.Opacity([1.0, 100.0, 1e4], [1e3, 50.0, 0.1]))
    waves = np.geomspace(60.0, 1300.0, channels)
    return lambda k, scheme: vm.observe(
        volume,
        medium,
        vm.Orthographic(57 + k, 33, resolution=400),
        wavelengths=waves,
        scheme=scheme,
    )


def carbon_monoxide(channels: int) -> Callable[[int, str], object]:
    """Return what draws CO 2-1 of a rotating disc, 64³ cells, at 200² pixels."""
    import voluminous as vm

    volume, j = disc(64), np.arange(41)
    up = j[1:]
    rest = 2 * 57.6359683e9 * up
    molecule = vm.Molecule(
        "co",
        28.0,
        np.cumsum(np.append(0.0, rest)) / 2.99792458e10,
        2.0 * j + 1.0,
        [str(n) for n in j],
        up,
        up - 1,
        7.203e-8 * 3 * up**4 / (2.0 * up + 1),
        rest,
    )
    medium = vm.Lines("n", molecule, temperature="T", velocity="v", turbulence=3e4)
    axis = vm.channels(-6, 6, channels, rest=rest[1])
    return lambda k, scheme: vm.observe(
        volume, medium, vm.Orthographic(57 + k, 33, resolution=200), velocities=axis, scheme=scheme
    )


def disc(cells: int) -> object:
    """Return a disc in rotation around a star like the Sun, 100 au across."""
    import voluminous as vm

    edges = np.linspace(-50.0, 50.0, cells + 1) * 1.496e13
    x, y, z = np.meshgrid(*[0.5 * (edges[1:] + edges[:-1])] * 3, indexing="ij")
    across, r = np.hypot(x, y) + 1e13, np.sqrt(x**2 + y**2 + z**2) + 1e13
    turn = np.sqrt(6.674e-8 * 1.989e33 / across) / across
    return vm.Volume(
        vm.CartesianGrid(edges, edges, edges, unit="cm"),
        n=1e3 * np.exp(-((z / (0.2 * across)) ** 2)) * (across / 1e14) ** -1.5,
        T=10.0 + 60.0 * (r / 1e14) ** -0.5,
        v_x=-turn * y,
        v_y=turn * x,
        v_z=0.0 * x,
    )


def _timed(draw: Callable[[], object]) -> tuple[float, float]:
    start, used = time.perf_counter(), time.process_time()
    draw()
    cores = len(os.sched_getaffinity(0))
    return time.perf_counter() - start, (time.process_time() - used) / cores


def _resident() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--channels", type=int, nargs="+", default=[3, 10, 40, 100])
    parser.add_argument("--scene", default="coefficients", choices=["coefficients", "dust", "co"])
    parser.add_argument("--schemes", nargs="+", default=SCHEMES)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", help="keep the numbers in this file")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        found = measure(options.channels[0], options.schemes[0], options.repeats, options.scene)
        print(json.dumps(found))
        return
    rows, every = [], {}
    for scheme in options.schemes:
        for channels in options.channels:
            command = [sys.executable, __file__, "--one", "--channels", str(channels)]
            command += ["--schemes", scheme, "--repeats", str(options.repeats)]
            command += ["--scene", options.scene]
            with tempfile.TemporaryDirectory() as home:  # where kernels are kept
                done = subprocess.run(
                    command,
                    env=os.environ | {"HOME": home},
                    capture_output=True,
                    text=True,
                    check=True,
                )
            found = every[f"{scheme} {channels}"] = json.loads(done.stdout.splitlines()[-1])
            first, warm = (f"{found[k]:.2f} ({found[f'{k}_cpu']:.2f})" for k in ("first", "warm"))
            # Intensities, transparencies and depths; of a large cube intensities alone.
            planes = 1 if options.scene != "coefficients" and channels > 64 else 3
            pixels = 400**2 if options.scene == "dust" else 200**2
            picture = channels * pixels * 4 * planes / 2**20
            rows.append(
                [f"{scheme}, {channels}", first, warm, f"{found['MB']:.0f}", f"{picture:.0f}"]
            )
    header = ["scheme, channels", "first, s", "warm, s", "memory, MB", "of it the picture"]
    print(table(header, rows))
    if options.json:
        Path(options.json).write_text(json.dumps(every, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
