"""yt's `create_scene` on a benchmark scene.

yt's opacity is per ray length (the camera's third width), its colours are multiplied by opacity.
The tables are filled directly, so that they hold our sum of Gaussians: `add_gaussian` has another
definition of the width, takes the maximum of two and multiplies a Gaussian with itself.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import yt
from yt.visualization.volume_rendering.api import Camera

from scenes import PARSEC, PIXELS, Scene

BINS = 4096
DEFAULT_SAMPLES = 10  # per cell, what `create_scene` gives


class YtScene:
    """One scene, ready to draw; `draw` returns seconds."""

    def __init__(self, scene: Scene, samples: int = DEFAULT_SAMPLES):
        """Load the grid and set the camera; `samples` are taken in each cell crossed."""
        yt.set_log_level("error")
        self.scene, self.depth = scene, 2 * scene.width
        density = scene.density()
        self.dataset = self._grid(density)  # yt's scene refers to it weakly
        self.yt_scene = yt.create_scene(self.dataset, ("stream", "n"))
        source = self.yt_scene[0]
        source.num_samples = samples
        source.set_transfer_function(self._table(np.log10(density)))
        self._aim(self.yt_scene.camera, self.dataset.arr)

    def draw(self) -> float:
        """Draw once; return the wall time in seconds."""
        start = time.perf_counter()
        self.image = self.yt_scene.render()
        return time.perf_counter() - start

    def picture(self) -> np.ndarray:
        """Return the intensity (ny, nx, 3), row 0 at the bottom (yt has [x, y], y downwards)."""
        return np.asarray(self.image).transpose(1, 0, 2)[::-1, :, :3]

    def describe(self) -> str:
        """Return the version and the number of threads (yt takes all)."""
        return f"yt {yt.__version__}, {os.cpu_count()} threads"

    def _grid(self, density: np.ndarray) -> Any:
        half = self.scene.width / 2
        return yt.load_uniform_grid(
            {("stream", "n"): (density.astype(np.float64), "dimensionless")},
            density.shape,
            length_unit=PARSEC,
            bbox=np.array([[-half, half]] * 3),
            nprocs=1,
        )

    def _table(self, logn: np.ndarray) -> yt.ColorTransferFunction:
        table = yt.ColorTransferFunction(
            (logn.min() - 0.1, logn.max() + 0.1), nbins=BINS, grey_opacity=True
        )
        nodes = np.asarray(table.alpha.x)
        _, extinction = self.scene.coefficients(nodes)
        table.alpha.y[:] = extinction * self.depth * PARSEC / self.scene.path_length
        for channel, values in enumerate(self.scene.source(nodes).T):
            table.funcs[channel].y[:] = values
        return table

    def _aim(self, camera: Camera, lengths: Callable[[Any, str], Any]) -> None:
        towards, up = self.scene.view()
        camera.resolution = (PIXELS, PIXELS)
        camera.width = lengths([self.scene.frame, self.scene.frame, self.depth], "code_length")
        camera.set_position(lengths(towards, "code_length"), north_vector=up)
