"""The light of all cells of a thin medium, beside that of its picture."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import get_backend
from ..cameras import Orthographic
from ..rendering.framing import first_camera
from ..rendering.sources.cells import SLAB, CellEvaluator
from ..rendering.sources.channel_layout import PerChannel, blocks_of
from .rings import Rings

if TYPE_CHECKING:
    from ..image.cube import Cube
    from ..media.contract import Medium
    from ..media.spectral import Bands

# An optical depth that takes less than 5 % of the light; and the difference that is told.
_THIN, _DIFFERENCE = 0.1, 0.01
# The part of the light that may come from outside of the frame.
_OUTSIDE = 1e-3
# Options with which not all cells are in memory, or others are drawn.
_OTHERS = ("memory", "executor", "checkpoint", "level", "view")
# In erg/s/cm²/Hz.
JANSKY = 1e-23


def beside_cells(
    cube: Cube,
    total: np.ndarray,
    medium: Medium,
    bands: Bands,
    camera: Any,
    options: Mapping[str, Any],
    stacklevel: int,
) -> dict[str, Any]:
    """Return the light of cells where a thin picture has another, for its provenance, and warn.

    Parameters
    ----------
    total : array, shape (channel,)
        Of the picture, the sum of intensities times areas of pixels, in erg/s/Hz/sr but for the
        volume's unit of length, squared.
    options : dict
        Of `render`: of parts of a volume, and of coarser levels, nothing is told.

    Notes
    -----
    Where the optical depth τ is small the light is ∫ j dV, less by τ/2 at most. It is compared in
    channels with τ < 0.1 of pictures that show all of a volume in memory, from infinity; not of
    moving lines, of which a channel shows few cells.
    """
    camera = first_camera(bands.volume) if camera is None else camera
    clear = cube.transparency  # of very many channels there is none
    others = any(options.get(name) is not None for name in _OTHERS)
    if clear is None or others or medium.sight or not isinstance(camera, Orthographic):
        return {}
    depth = -np.log(np.maximum(np.min(clear, axis=(0, 1)), 1e-30)) + np.zeros(len(total))
    thin = depth < _THIN
    if not thin.any():
        return {}
    light, outside = _light_of_cells(medium, bands, camera)
    thin &= (light > 0.0) & (outside <= _OUTSIDE * light)
    ratio = np.where(thin, total, 1.0) / np.where(thin, light, 1.0)
    # What is absorbed is no difference.
    off = np.maximum(ratio - 1.0, 1.0 - 0.5 * depth - ratio) * thin
    if not off.max() > _DIFFERENCE:
        return {}
    factor, unit = bands.length**2, "erg / (s Hz sr)"
    if cube.distance is not None:
        factor, unit = factor / cube.distance**2 / JANSKY, "Jy"
    worst = int(off.argmax())
    warnings.warn(
        f"the picture has {factor * total[worst]:.4g} {unit} at "
        f"{cube.spectral.wavelengths[worst]:.5g} micron, its cells have "
        f"{factor * light[worst]:.4g}, though the medium is thin: fields are interpolated between "
        "cells before they are multiplied, or pixels miss cells (antialias='adaptive'). "
        "scheme='first-order' draws cells as they are; an expression cellwise(a * b) is "
        "interpolated as one field, as in temperature='cellwise(density * T) / density'",
        stacklevel=stacklevel,
    )
    told = [float(factor * v) if t else None for v, t in zip(light, thin, strict=True)]
    return {"cells": {"light": told, "unit": unit}}


def _light_of_cells(
    medium: Medium, bands: Bands, camera: Orthographic
) -> tuple[np.ndarray, np.ndarray]:
    """Return Σ j V per channel, and the part of it from cells beside the frame."""
    volume = bands.volume.seen_by(camera)
    grid, backend = volume.grid, get_backend("auto", "single")
    frame = None if isinstance(camera, Rings) else camera.frame(grid)
    sums = np.zeros((2, medium.channels))
    for block in blocks_of(medium.channels):
        part = medium.block(block.start, block.stop)
        evaluator = CellEvaluator(volume, part, PerChannel(part), backend)
        for first in range(0, grid.size, SLAB):
            last = min(first + SLAB, grid.size)
            values, _ = evaluator.classify(first, last - first)
            bright = np.nan_to_num([np.array(v) for v in values[: part.channels]])
            light = bright * grid.cell_volumes.reshape(-1)[first:last] / grid.scale
            beside = np.zeros(last - first, bool)
            if frame is not None:
                u, v, _ = camera.project(grid.cell_centers(first, last), grid)
                place = np.abs(np.stack([u, v]) - np.array(frame.shift)[:, None])
                beside = (place > 0.5 * np.array(frame.width)[:, None]).any(axis=0)
            sums[:, block] = sums[:, block] * (first > 0) + [
                light.sum(axis=1),
                light[:, beside].sum(axis=1),
            ]
    light, outside = sums * bands.unit
    return light, outside
