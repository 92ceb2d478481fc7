"""What is told beside a picture: light that is scattered, and the light of all cells."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr, from_host, get_backend
from ..cameras import Orthographic
from ..geometry import CARTESIAN
from ..rendering.framing import first_camera
from ..rendering.sources.cells import SLAB, CellEvaluator
from ..schemes.channels import channel_groups
from ..spectral import Dust
from .rings import Rings

if TYPE_CHECKING:
    from ..image.cube import Cube

# What scatters less changes the light of dust by less than 1 % where no star shines on it:
# S = (1 - ω) B + ω J with J up to B (Rybicki & Lightman 1979, section 1.7).
_LEAST_ALBEDO = 0.01
# An optical depth that takes up to 5 % of the light, the difference that is told, and the part of
# the light that may come from beside the frame.
_THIN, _DIFFERENCE, _BESIDE = 0.1, 0.01, 1e-3
# Options with which cells are not in memory, or others are drawn.
_OTHERS = ("memory", "executor", "checkpoint", "level", "view", "clip")
# In erg/s/cm²/Hz.
JANSKY = 1e-23


def warn_of_scattering(medium: Any, stacklevel: int) -> None:
    """Warn if dust scatters light at the frequencies of a medium: it is not in the picture."""
    for part in medium.components():
        albedo = part.albedo() if isinstance(part, Dust) else np.zeros(1)
        if albedo.max() <= _LEAST_ALBEDO:
            continue
        constants, nu = part.bands.constants, part.bands.frequencies[albedo.argmax()]
        warnings.warn(
            f"dust has an albedo of {albedo.max():.2g} at {1e4 * constants.c / nu:.4g} micron, and "
            "light that is scattered into the line of sight is not computed: take RADMC-3D for "
            "it, or say vm.Dust(…, scattering='none') where it does not matter",
            stacklevel=stacklevel,
        )
        return


def beside_cells(
    cube: Cube, total: np.ndarray, medium: Any, camera: Any, options: Mapping[str, Any], level: int
) -> dict[str, Any]:
    """Return the light of cells where a thin picture has another, for its provenance, and warn.

    `total` are sums of intensities times areas of pixels, in the volume's unit of length; `options`
    those of `render`; `level` is the warning's. Where the optical depth τ is small the light is
    ∫ j dV, less by τ/2 at most. It is compared in pictures of all of a volume in memory, from
    infinity; not of moving lines, of which a channel shows few cells.
    """
    clear, others = cube.transparency, any(options.get(name) is not None for name in _OTHERS)
    camera = first_camera(medium.components()[0].bands.volume) if camera is None else camera
    # Of very many channels there is no transparency.
    if clear is None or others or medium.sight or not isinstance(camera, Orthographic):
        return {}
    depth = -np.log(np.maximum(np.min(clear, axis=(0, 1)), 1e-30)) + np.zeros(len(total))
    if not (depth < _THIN).any():
        return {}
    light, beside = _light_of_cells(medium, camera)
    thin = (depth < _THIN) & (light > 0.0) & (beside <= _BESIDE * light)
    ratio = np.where(thin, total, 1.0) / np.where(thin, light, 1.0)
    off = np.maximum(ratio - 1.0, 1.0 - 0.5 * depth - ratio) * thin  # not what is absorbed
    if not off.max() > _DIFFERENCE:
        return {}
    centimetres = medium.components()[0].bands.length
    factor, unit = centimetres**2, "erg / (s Hz sr)"
    if cube.distance is not None:
        factor, unit = (centimetres / cube.distance) ** 2 / JANSKY, "Jy"
    worst = int(off.argmax())
    warnings.warn(
        f"the picture has {factor * total[worst]:.4g} {unit} at "
        f"{cube.spectral.wavelengths[worst]:.5g} micron, its cells have "
        f"{factor * light[worst]:.4g}, though the medium is thin: fields are interpolated before "
        "they are multiplied, or pixels miss cells (antialias='adaptive'). scheme='first-order' "
        "draws cells as they are; cellwise(a * b) is interpolated as one field, as in "
        "temperature='cellwise(density * T) / density'",
        stacklevel=level,
    )
    flux = [float(factor * v) if t else None for v, t in zip(light, thin, strict=True)]
    return {"cells": {"light": flux, "unit": unit}}


def _light_of_cells(medium: Any, camera: Orthographic) -> np.ndarray:
    """Return Σ j V per channel, and that of cells beside the frame, shape (2, channel)."""
    bands = medium.components()[0].bands
    grid, backend = bands.volume.grid, get_backend("auto", "single")
    # Of boxes never all at once: they would take as much memory as a field.
    volumes = None if tuple(grid.coordinates) == CARTESIAN else grid.cell_volumes.reshape(-1)

    def beside(points: np.ndarray) -> np.ndarray:
        frame = camera.frame(grid)
        away = np.abs(np.stack(camera.project(points, grid)[:2]).T - frame.shift)
        return np.asarray((away > 0.5 * np.array(frame.width)).any(axis=1))

    corners = np.array(np.meshgrid(*grid.bounds, indexing="ij")).reshape(3, -1)
    whole = isinstance(camera, Rings) or not beside(corners).any()
    groups = channel_groups(medium)
    evaluator = CellEvaluator(bands.volume, medium, backend)
    evaluators = [evaluator.using(evaluator.channels.group(group)) for group in groups]
    sums = np.zeros((len(groups), 2, evaluators[0].channels.emissions))
    for first in range(0, grid.size, SLAB):
        last = min(first + SLAB, grid.size)
        if volumes is None:
            weights = [np.prod(grid.cell_sizes(first, last), axis=0) / grid.scale]
        else:
            weights = [volumes[first:last] / grid.scale]
        if not whole:
            weights.append(weights[0] * beside(grid.cell_centers(first, last)))
        weighed = [from_host(backend.Wide, w) for w in weights if w.any()]
        for own, evaluator in zip(sums, evaluators, strict=True):
            values = evaluator.classify(first, last - first)[0][: own.shape[1]]
            values = [dr.select(dr.isfinite(v), v, 0.0) for v in values]
            found = [[dr.sum(v * w) for v in values] for w in weighed]
            dr.eval(found)
            own[: len(found)] += np.array(found, np.float64).reshape(len(found), -1)
    light = np.zeros((2, medium.channels))
    for group, own in zip(groups, sums, strict=True):  # the last may overlap
        light[:, group] = own
    return np.asarray(light * bands.unit)
