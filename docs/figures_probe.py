"""The picture of "What a ray saw"."""

from __future__ import annotations

from pathlib import Path

from drawing import saved

import voluminous as vm


def probe(target: Path, pixels: int) -> None:
    """A ray through two shells: fields, coefficients, optical depth and intensity."""
    core = vm.models.prestellar_core(max(16, pixels // 6))
    shells = vm.Gaussian("log10(density)", 3.6, 0.1, (0.9, 0.4, 0.1), 0.6, 1e17)
    shells += vm.Gaussian("log10(density)", 4.3, 0.1, (0.2, 0.4, 0.9), 0.9, 1e17)
    camera = vm.Orthographic(incl=60, phi=30, resolution=24)
    found = vm.probe(core, shells, camera, pixel=(12, 13), background=(0.3, 0.3, 0.3))
    saved(found.plot(), target, dpi=90, colors=64)


PROBE_FIGURES = {"probe": probe}
