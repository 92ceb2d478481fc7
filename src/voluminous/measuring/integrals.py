"""Integrals of several quantities along the lines of sight: by rays, or exactly."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..backend import get_backend
from ..cameras import Orthographic
from ..cameras.contract import check_camera
from ..errors import InputError, unknown_name
from ..geometry import CARTESIAN
from ..media import Coefficients
from ..progress import Progress, reported_range
from ..rendering import render
from .known import check_finite, with_known
from .shadows import Screen, onto_pixels
from .thin import Thin

METHODS = ("rays", "exact")
# Cells whose shadows are made at once: bounds the memory for their places.
_CHUNK = 1 << 21


def integrals(
    volume: Any,
    expressions: Sequence[Any],
    camera: Any,
    *,
    method: str = "rays",
    samples: int = 1,
    precision: str = "single",
    device: str = "auto",
    progress: Progress = None,
) -> np.ndarray:
    """Return ∫ q ds for each expression q: plain numbers, lengths in the volume's unit.

    Cells where one of them has no value count nothing for all: means are of what is known.

    Returns
    -------
    float64 array, shape (k, ny, nx)

    Raises
    ------
    UnknownNameError
        If there is no such method.
    InputError
        If the method cannot be used with the camera or the grid, or a quantity is infinite.
    """
    check_camera(camera, "a map")  # of None `render` would make one
    if method == "exact":
        check_exact(volume.grid, camera)
        return exact_maps(volume.seen_by(camera), expressions, camera, device, together=True)
    if method != "rays":
        raise unknown_name("method", str(method), METHODS)
    seen, known = with_known(volume.seen_by(camera), expressions)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="the picture shows nothing of the medium")
        image = render(
            seen,
            Coefficients(known, 0),
            camera,
            scheme=Thin(),
            cutoff=0.0,
            samples=samples,
            precision=precision,
            device=device,
            progress=progress,
        )
    if not image.intensity.any():
        told = " and ".join(q.text for q in expressions if q is not None)
        warnings.warn(
            f"{told}: zero along every ray of this camera, which looks elsewhere, or whose pixels "
            "meet nothing of what is small",
            stacklevel=4,
        )
    return np.moveaxis(image.intensity, -1, 0).astype(np.float64)


def exact_maps(
    volume: Any,
    expressions: Sequence[Any],
    camera: Any,
    device: str,
    parts: Any = None,
    together: bool = False,
) -> np.ndarray:
    """Return the pixels' mean columns: cells' shadows, clipped against the pixels.

    Parameters
    ----------
    volume : Volume
        As it is seen.
    expressions : sequence of Expression or None
        None stands for 1: how much space there is.
    parts : Parts, optional
        Which part of each cell counts.
    together : bool
        Cells where one expression has no value count nothing for the others either.
    """
    grid, frame = volume.grid, camera.frame(volume.grid)
    backend, screen = get_backend(device, "double"), screen_of(frame)
    total = np.zeros((len(expressions), *frame.pixels[::-1]))
    for first in reported_range(grid.size, _CHUNK):
        last = min(first + _CHUNK, grid.size)
        sizes = np.asarray(grid.cell_sizes(first, last))
        # In units of the scale: products of three lengths and a density may be too large, or small.
        share = np.prod(sizes / grid.scale, axis=0) * (
            1.0 if parts is None else parts.of(first, last)
        )
        values = np.array(
            [
                np.ones(last - first)
                if e is None
                else volume.evaluate_cells(e, first, last, double=True)
                for e in expressions
            ]
        )
        for e, own in zip(expressions, values, strict=True):
            if e is not None:
                check_finite(np.where(share == 0, 0.0, own), e, first, grid)
        unknown = np.isnan(values)
        if together:
            unknown = np.any(unknown, axis=0)
        amounts = np.where(unknown | (share == 0), 0.0, values) * share
        centers = np.asarray(grid.cell_centers(first, last))
        total += onto_pixels(screen, centers, sizes, amounts, backend)
    return total / np.prod(np.asarray(frame.pixel) / grid.scale) * grid.scale


def check_exact(grid: Any, camera: Any) -> None:
    """Refuse what cells' shadows are not known for.

    Raises
    ------
    InputError
        Says what to do.
    """
    if not isinstance(camera, Orthographic):
        raise InputError(
            f"method='exact' needs parallel lines of sight (vm.Orthographic), got "
            f"{type(camera).__name__}; use method='rays' with samples"
        )
    if not grid.cells_are_boxes or tuple(grid.coordinates) != CARTESIAN:
        raise InputError(
            f"method='exact' needs cells that are boxes, got a {type(grid).__name__}; use "
            "method='rays' with samples"
        )


def screen_of(frame: Any) -> Screen:
    """Return the pixels of an orthographic camera."""
    center, right, up = frame.vectors[:3]
    pixel = np.asarray(frame.pixel)
    axes = np.stack([right, up]) / pixel[:, None]
    middle = 0.5 * np.asarray(frame.pixels) - np.asarray(frame.shift) / pixel
    return Screen(axes, middle - axes @ center, frame.pixels)
