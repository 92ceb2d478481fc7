"""Time the first picture in a new process, import included, from outside the process.

    python benchmarks/startup.py --repeat 5

Cold: Dr.Jit's kernel cache is an empty folder, made anew for each run. Warm: the folder the cold
runs have filled. Beside it: the import alone, and Python doing nothing, which is in all of them.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from timing import summary, table

FIRST_PICTURE = """
from astropy import units as u
import voluminous as vm
volume = vm.models.prestellar_core()
path = 2.5e16 * u.cm
blue, orange = (0.4, 0.4, 0.8), (0.89, 0.47, 0.06)
medium = vm.Gaussian("log10(density)", 3.5, 0.05, color=blue, opacity=0.001, path_length=path)
medium += vm.Gaussian("log10(density)", 4.0, 0.10, color=orange, opacity=0.001, path_length=path)
camera = vm.Orthographic(incl=60, phi=30, width=0.25 * u.pc, resolution=400)
image = vm.render(volume, medium, camera, scheme="second-order")
image.save("core.png")
"""
IMPORT = "import voluminous"
NOTHING = "pass"


def seconds_of(script: str, cache: Path, folder: Path) -> float:
    """Return the wall time of a new Python that runs a script in a folder.

    Raises
    ------
    RuntimeError
        If the script fails; with what it said.
    """
    environment = os.environ | {"DRJIT_CACHE_DIR": str(cache)}
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=folder, env=environment, capture_output=True, text=True
    )
    elapsed = time.perf_counter() - start
    if done.returncode:
        raise RuntimeError(f"the script ended with status {done.returncode}:\n{done.stderr}")
    return elapsed


def measure(repeat: int, folder: Path) -> dict[str, list[float]]:
    """Return the seconds of each kind of start, taken in turns."""
    kinds = ("cold", "warm", "import", "python")
    seconds: dict[str, list[float]] = {kind: [] for kind in kinds}
    # The first run reads the libraries from disk into memory; it is not what is asked.
    seconds_of(FIRST_PICTURE, folder / "unmeasured", folder)
    for turn in range(repeat):
        cache = folder / f"cache{turn}"
        seconds["cold"].append(seconds_of(FIRST_PICTURE, cache, folder))
        seconds["warm"].append(seconds_of(FIRST_PICTURE, cache, folder))
        seconds["import"].append(seconds_of(IMPORT, cache, folder))
        seconds["python"].append(seconds_of(NOTHING, cache, folder))
    return seconds


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    return parser.parse_args()


def main() -> None:
    """Measure and print."""
    options = parse()
    with tempfile.TemporaryDirectory() as folder:
        seconds = measure(options.repeat, Path(folder))
    results = {kind: summary(values) for kind, values in seconds.items()}
    rows = [[kind, f"{r['median']:.2f}", f"{r['min']:.2f}"] for kind, r in results.items()]
    print(table(["new process", "median s", "min s"], rows))
    if options.json:
        options.json.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
