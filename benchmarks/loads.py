"""How near each scheme comes to the limit that its look-ups set.

    python benchmarks/loads.py

For each scheme the same rays are followed by a scheme that makes the same look-ups, adds what it
gets, and does nothing else: the limit. Both take turns; printed are their times and the ratio.
"""

from __future__ import annotations

import argparse
from typing import Any

import voluminous as vm
from our_scene import camera_of, medium_of, volume_of
from scenes import SCENES
from timing import ratios, summary, table, take_turns
from voluminous.schemes import get_scheme
from voluminous.schemes.base import FieldScheme
from voluminous.schemes.path import Path


class Loads(FieldScheme):
    """Look-ups of another scheme, and nothing else."""

    def __init__(self, scheme: Any) -> None:
        self.name, self.order = f"loads of {scheme.name}", scheme.order
        self.coefficients_at = scheme.coefficients_at
        if isinstance(scheme, FieldScheme):
            self.coarseness = scheme.coarseness

    def solve(self, segment: Any, source: Any, carried: list[Any]) -> tuple[Path, list[Any]]:
        """Return the sum of all that is looked up as emission."""
        total = sum(self._found(source, segment))
        channels, real = source.channels, type(segment.length)
        return Path(
            [total for _ in range(channels.emissions)],
            [real(1) for _ in range(channels.extinctions)],
            [real(0) for _ in range(channels.extinctions)],
        ), carried

    def _found(self, source: Any, segment: Any) -> list[Any]:
        if self.coefficients_at == "cell":
            return source.gather(segment.cell, segment.active)
        if self.coefficients_at == "vertex":
            corners = segment.walk.exit_corners(segment.track, segment)
            return source.interpolate(corners, segment.active)
        found = source.along(segment).corners
        return [v for corners in found.values() for plane in corners for row in plane for v in row]


def main() -> None:
    """Print one line per scheme."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeat", type=int, default=15)
    parser.add_argument("--scene", choices=list(SCENES), default="core_opaque")
    options = parser.parse_args()
    scene = SCENES[options.scene]
    volume, medium, camera = volume_of(scene), medium_of(scene), camera_of(scene)
    volume["logn"] = "log10(density)"
    medium = sum(
        vm.Gaussian("logn", p.center, p.width, p.color, p.opacity, p.path_length)
        for p in medium.components()
    )
    cases: dict[str, tuple[str, float | None]] = {
        "first-order": ("first-order", 1e-3),
        "second-order": ("second-order", 1e-3),
        "post-classified, 1e-3": ("post-classified", 1e-3),
        "post-classified, None": ("post-classified", None),
    }
    from time import perf_counter

    def drawing(scheme: Any, tolerance: float | None) -> Any:
        def draw() -> float:
            start = perf_counter()
            vm.render(volume, medium, camera, scheme=scheme, tolerance=tolerance, device="cpu")
            return perf_counter() - start

        return draw

    draws = {}
    for name, (scheme, tolerance) in cases.items():
        draws[name] = drawing(scheme, tolerance)
        draws[f"{name}: loads"] = drawing(Loads(get_scheme(scheme)), tolerance)
    seconds = take_turns(draws, dict.fromkeys(draws, options.repeat))
    rows = []
    for name in cases:
        limit = ratios(seconds[f"{name}: loads"], seconds[name])
        times = (summary(seconds[n])["median"] * 1e3 for n in (name, f"{name}: loads"))
        rows.append([name, *(f"{t:.1f}" for t in times), f"{limit['median']:.2f}"])
    print(table(["", "median ms", "its loads ms", "fraction of the limit"], rows))


if __name__ == "__main__":
    main()
