"""Time a film beside its pictures alone, watch its memory, and kill it again and again.

    python benchmarks/movies.py                              # 240 frames of 128³ cells at 800²
    python benchmarks/movies.py --frames 60 --size 200 --kills 5

Half of the pictures are rendered before the film and half after it, so that load from elsewhere
meets both. Times of processors, of all threads, depend on it less.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil

import voluminous as vm


def main() -> None:
    """Make a film, and the same film with interruptions."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=128)
    parser.add_argument("--size", type=int, default=800)
    parser.add_argument("--frames", type=int, default=240)
    parser.add_argument("--suffix", default=".mp4")
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument("--into", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.into:
        film(args, args.into, None)
        return
    with tempfile.TemporaryDirectory() as folder:
        whole, cut = Path(folder, "whole"), Path(folder, "cut")
        compare(args, whole)
        if args.kills:
            interrupt(args, cut, whole)


def scene(args: Any) -> tuple[Any, Any, list[Any]]:
    """Return volume, medium and cameras."""
    volume = vm.models.prestellar_core(args.cells)
    medium = vm.suggest_medium(volume).calibrated(volume)
    camera = vm.Orthographic.framing(volume, medium, 60, 30, resolution=args.size)
    return volume, medium, vm.orbit(camera, turns=1, frames=args.frames)


def film(args: Any, folder: Path, progress: Any) -> None:
    """Make the film and keep its frames."""
    folder.mkdir(exist_ok=True)
    path = folder / f"film{args.suffix}"
    vm.movie(*scene(args), path, keep_frames=True, progress=progress)


def compare(args: Any, folder: Path) -> None:
    """Print the film's time over that of its pictures, and its memory."""
    volume, medium, cameras = scene(args)
    process = psutil.Process()
    vm.render(volume, medium, cameras[0])
    spent = {"pictures": [0.0, 0.0], "film": [0.0, 0.0]}
    memory = {}

    def timed(name: str, what: Any) -> None:
        wall, cpu = time.perf_counter(), time.process_time()
        what()
        spent[name][0] += time.perf_counter() - wall
        spent[name][1] += time.process_time() - cpu

    def pictures(some: list[Any]) -> None:
        for camera in some:
            vm.render(volume, medium, camera)

    def progress(done: int, total: int) -> None:
        memory[done] = process.memory_info().rss / 1e6

    half = args.frames // 2
    timed("pictures", lambda: pictures(cameras[:half]))
    timed("film", lambda: film(args, folder, progress))
    timed("pictures", lambda: pictures(cameras[half:]))
    ratios = [f / p for f, p in zip(spent["film"], spent["pictures"], strict=True)]
    early, late = memory[min(10, args.frames)], memory[args.frames]
    more = 100 * (late / early - 1)
    print(
        f"{args.frames} pictures {spent['pictures'][0]:.1f} s, as a film {spent['film'][0]:.1f} s: "
        f"{ratios[0]:.3f} times; of the processors {ratios[1]:.3f} times\n"
        f"memory at frame 10 {early:.0f} MB, at the last {late:.0f} MB ({more:+.1f} %); "
        f"load {psutil.getloadavg()[0]:.1f}"
    )


def interrupt(args: Any, folder: Path, whole: Path) -> None:
    """Kill processes that make the film; print what other files come out."""
    command = [sys.executable, *sys.argv, "--into", str(folder)]
    for k in range(args.kills):
        child = subprocess.Popen(command)
        # The last dies while it encodes.
        last = k == args.kills - 1
        enough = args.frames if last else (k + 1) * args.frames // (args.kills + 1)
        while child.poll() is None and len(list(folder.glob("film*/*.png"))) < enough:
            time.sleep(0.05)
        while last and child.poll() is None and not list(folder.glob(".film*")):
            time.sleep(0.002)
        child.kill()
        child.wait()
        left = [path.name for path in folder.rglob("*") if ".part" in path.name]
        print(f"killed at {len(list(folder.glob('film*/*.png')))} frames, which left {left}")
    subprocess.run(command, check=True)
    here, there = hashes(folder), hashes(whole)
    differ = sorted(name for name in {*here, *there} if here.get(name) != there.get(name))
    print(f"{len(here)} files; other than without interruptions: {differ or 'none'}")


def hashes(folder: Path) -> dict[str, str]:
    """Return what is in a folder: of a film its name alone, as encoders differ in last bits."""
    return {
        str(path.relative_to(folder)): ""
        if path.parent == folder
        else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


if __name__ == "__main__":
    main()
