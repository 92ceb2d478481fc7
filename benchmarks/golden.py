"""Pictures before and after: some 70 of them, drawn with the code of two commits and compared.

    PYTHONPATH=BEFORE/src python benchmarks/golden.py draw before.npz
    PYTHONPATH=AFTER/src  python benchmarks/golden.py draw after.npz
    python benchmarks/golden.py compare before.npz after.npz

Every grid with every kind of medium in every scheme, both precisions; in blocks, for volumes larger
than memory; a spectrum; and real data where they are (VOLUMINOUS_TEST_DATA). `compare` prints, for
each picture, the largest difference and the share of pixels that differ at all; of those with error
control how far both are from a picture to 1e-6 in double precision, and the share of pixels within
the estimated error; and the ratio of times (the best of three pictures after the first).
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import voluminous as vm

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

PIXELS = 96
ORTHO = {"incl": 60, "phi": 30}
# Smooth, with a bump in a corner, from 0 to about 1.4; a second field for gates and colours.
FIELDS = {
    "a": "exp(-2 * (x**2 + y**2 + 1.5 * z**2)) + 0.5 * exp(-20 * ((x - 0.4)**2 + (y + 0.3)**2))",
    "b": "0.5 + 0.5 * sin(5 * x + 3 * y) * cos(4 * z)",
}


def near(x: Any, y: Any, z: Any, size: Any) -> Any:
    """Return where an octree is refined."""
    return np.hypot(np.hypot(x - 0.4, y + 0.3), z) < 3 * size


def patches() -> Any:
    """Return a base grid with two patches, one in the other."""
    walls = np.linspace(-1, 1, 17)
    low, shape = [[0, 0, 0], [8, 8, 8], [24, 24, 24]], [[16] * 3, [16] * 3, [16] * 3]
    return vm.PatchGrid.from_boxes(walls, walls, walls, [0, 1, 2], low, shape, 2)


WALLS = np.linspace(-1, 1, 9)
GRIDS: dict[str, Callable[[], Any]] = {
    "uniform": lambda: vm.CartesianGrid.uniform(32, (-1, 1)),
    "rectilinear": lambda: vm.CartesianGrid(*[np.sinh(np.linspace(-1, 1, 25)) / np.sinh(1)] * 3),
    "octree": lambda: vm.OctreeGrid.from_function(WALLS, WALLS, WALLS, near, 3),
    "patches": patches,
    "spherical": lambda: vm.SphericalGrid(
        np.linspace(0, 1, 17), np.linspace(0, np.pi, 17), np.linspace(0, 2 * np.pi, 25)
    ),
    "cylindrical": lambda: vm.CylindricalGrid(
        np.linspace(0, 1, 17), np.linspace(0, 2 * np.pi, 25), np.linspace(-1, 1, 17)
    ),
}
SHELLS = vm.Gaussian("a", 0.3, 0.03, (0.3, 0.4, 0.9), 0.3, 0.1) + vm.Gaussian(
    "a", 0.7, 0.06, (0.9, 0.5, 0.1), 0.6, 0.1
)
MEDIA: dict[str, Any] = {
    "shells": SHELLS,
    "coefficients": vm.Coefficients(["a", "2*a*b", "a**2"], "3*a"),
    "per channel": vm.Coefficients(["a", "2*a*b", "a**2"], ["a", "2*a", "4*b"]),
    "surfaces": vm.Isosurface("a", level=[0.3, 0.7], color="plasma", opacity=0.4, shading=0.6),
    "gated": vm.Colormap("a", "viridis", 0, 1.2, 0.8, 0.2, where="b > 0.4"),
    "coloured": vm.Gaussian("a", 0.5, 0.05, vm.ColorBy("b", "inferno", 0, 1), 0.8, 0.1),
    "table": vm.Table(
        "a", [0.1, 0.3, 0.32, 0.8], [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], 0.7
    ),
    "opaque": vm.Rectangle("a", 0.5, 0.1, (1, 0.8, 0.2), 40.0, 0.1),
}
SCHEMES: dict[str, dict[str, Any]] = {
    "default": {},
    "None": {"tolerance": None},
    "first": {"scheme": "first-order"},
    "second": {"scheme": "second-order"},
    "olson": {"scheme": "olson-kunasz", "precision": "double"},
}
# On every grid; all others on the uniform one.
EVERYWHERE = [
    ("shells", "default"),
    ("shells", "None"),
    ("coefficients", "first"),
    ("coefficients", "second"),
    ("surfaces", "default"),
    ("gated", "default"),
]


def scenes() -> Iterator[tuple[str, Callable[[], tuple[Any, Any, Any, dict[str, Any]]]]]:
    """Yield names, and what returns a volume, a medium, a camera and options."""
    camera = vm.Orthographic(**ORTHO, width=2.4, resolution=PIXELS)
    inside = vm.Perspective((0.2, 0.1, 0.15), (1, 0.2, 0), 80, resolution=PIXELS)
    outside = vm.Perspective((3, 1, 1), (0, 0, 0), 50, resolution=PIXELS)
    volumes: dict[str, Any] = {}

    def volume(kind: str) -> Any:
        if kind not in volumes:
            volumes.clear()
            volumes[kind] = vm.Volume(GRIDS[kind]())
            for name, text in FIELDS.items():
                volumes[kind][name] = text
        return volumes[kind]

    for kind in GRIDS:
        for medium, how in EVERYWHERE:
            yield (
                f"{kind}, {medium}, {how}",
                lambda k=kind, m=medium, h=how: (volume(k), MEDIA[m], camera, SCHEMES[h]),
            )
    for medium in [m for m in MEDIA if m not in ("shells", "surfaces", "gated")]:
        yield (
            f"uniform, {medium}, default",
            lambda m=medium: (volume("uniform"), MEDIA[m], camera, {}),
        )
    more = {
        "double": (SHELLS, camera, {"precision": "double"}),
        "1e-5": (SHELLS, camera, {"tolerance": 1e-5}),
        "olson": (MEDIA["coefficients"], camera, SCHEMES["olson"]),
        "inside": (SHELLS, inside, {}),
        "outside": (SHELLS, outside, {}),
        "along z": (SHELLS, camera.__class__(0, 0, width=2.4, resolution=PIXELS), {}),
        "four rays": (SHELLS, camera, {"samples": 2, "tolerance": None}),
        "stars": (
            SHELLS,
            camera,
            {"objects": [vm.Stars(np.eye(3) * 0.5, "white", radii=0.05), vm.Boxes()]},
        ),
    }
    for name, (medium, view, options) in more.items():
        yield (
            f"uniform, {name}",
            lambda m=medium, v=view, o=options: (volume("uniform"), m, v, o),
        )
    yield from _larger_than_memory(volume, camera)
    yield "spectrum, gas and dust", _gas_and_dust
    yield from _real()


def _larger_than_memory(volume: Callable[[str], Any], camera: Any) -> Iterator[tuple[str, Any]]:
    """Yield scenes that are read and drawn block by block."""
    folder = Path(tempfile.mkdtemp())

    def stored(kind: str, memory: str, medium: Any, options: dict[str, Any]) -> Any:
        path = folder / f"{kind}.zarr"
        if not path.exists():
            volume(kind).save(path, stats=True, **({"chunks": 8} if kind == "uniform" else {}))
        return vm.open(path), medium, camera, {**options, "memory": memory}

    for kind, memory in (("uniform", "190 MB"), ("octree", "520 MB")):
        for name, how in (("shells", "default"), ("shells", "None"), ("coefficients", "first")):
            yield (
                f"in blocks, {kind}, {name}, {how}",
                lambda k=kind, m=memory, n=name, h=how: stored(k, m, MEDIA[n], SCHEMES[h]),
            )


def _gas_and_dust() -> tuple[Any, Any, Any, dict[str, Any]]:
    """Return a collapsing core, and how it is observed: a line of CO and dust, 21 channels."""
    core = vm.models.prestellar_core(32)
    for axis in "xyz":
        core[f"fall_{axis}"] = f"-0.3 km/s * {axis} / sqrt(x**2 + y**2 + z**2 + (0.01 pc)**2)"
    levels = np.arange(4)
    einstein_a = 7.203e-8 * 3 * levels[1:] ** 4 / (2 * levels[1:] + 1)
    energies, weights = 1.9225 * levels * (levels + 1), 2 * levels + 1
    frequencies = 2 * 57.6359683e9 * levels[1:]
    co = vm.Molecule(
        "CO", 28.0, energies, weights, levels, levels[1:], levels[:-1], einstein_a, frequencies
    )
    gas = vm.Lines("1e-7 * density", co, temperature="12 K", velocity="fall", turbulence="0.1 km/s")
    ice = vm.Opacity.published("ossenkopf-henning-1994")
    dust = vm.Dust("density * 4.7e-26 g", "12 K", ice)
    camera = vm.Orthographic(**ORTHO, width="0.45 pc", resolution=PIXELS)
    channels = vm.channels(-1, 1, 21, line="CO 1-0")
    return core, gas + dust, camera, {"velocities": channels, "distance": "140 pc"}


def drawn(volume: Any, medium: Any, camera: Any, **options: Any) -> Any:
    """Return the picture of a scene; at velocities an observation."""
    verb = vm.observe if "velocities" in options else vm.render
    return verb(volume, medium, camera, **options)


def _real() -> Iterator[tuple[str, Any]]:
    try:
        import real_data

        names = real_data.names()
    except Exception as error:
        print(f"no real data: {error}")
        return
    for name in names:

        def scene(name: str = name) -> tuple[Any, Any, Any, dict[str, Any]]:
            volume = real_data.load(name)
            medium = vm.suggest_medium(volume)
            first = vm.Orthographic.framing(volume, medium)
            told = {k: v for k, v in first.describe().items() if k not in ("type", "resolution")}
            return volume, medium, vm.Orthographic(**told, resolution=PIXELS), {}

        yield f"real, {name}", scene


def draw(path: str, only: str) -> None:
    """Draw all pictures with the package that is imported, and keep them."""
    kept: dict[str, Any] = {}
    for name, make in scenes():
        if not re.search(only, name):
            continue
        try:
            volume, medium, camera, options = make()
            image = drawn(volume, medium, camera, **options)
            times = []
            for _ in range(3):
                start = time.perf_counter()
                image = drawn(volume, medium, camera, **options)
                times.append(time.perf_counter() - start)
        except Exception as error:
            print(f"{name}: {type(error).__name__}: {error}")
            continue
        kept[f"{name}|intensity"], kept[f"{name}|time"] = image.intensity, min(times)
        if image.error is not None:
            fine = {**options, "tolerance": 1e-6, "precision": "double"}
            kept[f"{name}|error"] = image.error
            kept[f"{name}|truth"] = drawn(volume, medium, camera, **fine).intensity
        print(f"{name}: {1e3 * min(times):.0f} ms", flush=True)
    np.savez_compressed(path, **kept)


def compare(before: str, after: str) -> None:
    """Print what differs."""
    old, new = (dict(np.load(path)) for path in (before, after))
    names = [key.partition("|")[0] for key in old if key.endswith("|time")]
    print(f"{'picture':38} {'largest':>8} {'differ':>7}  {'true error':>17} {'honest':>13}  time")
    for name in names:
        if f"{name}|time" not in new:
            print(f"{name:38} missing")
            continue
        a, b = old[f"{name}|intensity"], new[f"{name}|intensity"]
        if a.shape != b.shape:
            print(f"{name:38} shapes {a.shape} and {b.shape}")
            continue
        top = max(float(np.nanmax(np.abs(a))), 1e-300)
        share = 100 * np.mean(np.any(a != b, axis=-1))
        line = f"{name:38} {np.nanmax(np.abs(a - b)) / top:8.1e} {share:6.1f}%  "
        line += _errors(old, new, name, top)
        print(line + f"  {float(new[f'{name}|time']) / float(old[f'{name}|time']):.2f}")


def _errors(old: dict[str, Any], new: dict[str, Any], name: str, top: float) -> str:
    if f"{name}|truth" not in old or f"{name}|truth" not in new:
        return " " * 31
    found = []
    for one in (old, new):
        off = np.abs(one[f"{name}|intensity"] - old[f"{name}|truth"])
        # The truth is rounded and has an error of its own.
        within = off.max(axis=-1) <= one[f"{name}|error"] + 3e-6 * top
        found.append((np.max(off) / top, 100 * np.mean(within)))
    (a, p), (b, q) = found
    return f"{a:8.1e} {b:8.1e} {p:6.2f} {q:6.2f}"


def main() -> None:
    """Draw or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["draw", "compare"])
    parser.add_argument("paths", nargs="+")
    parser.add_argument("--only", default="", help="regular expression for names of pictures")
    args = parser.parse_args()
    if args.what == "draw":
        draw(args.paths[0], args.only)
    else:
        compare(*args.paths)


if __name__ == "__main__":
    main()
