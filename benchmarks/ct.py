"""A head CT by its presets: voluminous and PyVista in one process, in turns, by processor time.

    VOLUMINOUS_TEST_DATA=DATA python benchmarks/ct.py --repeat 7

Skin and bone, shaded, 256 x 256 x 108 cells, 400 x 400 pixels. PyVista draws VTK's fixed-point
ray caster (`mapper="fixed_point"`) with the preset's own points as its tables, one sample per
cell, trilinear, Phong shading with the same ambient part. Processor time, because that of a
machine that others use says more than its clock.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import voluminous as vm
from timing import ratios, summary, table, take_turns

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

PIXELS = 400
SHADING = 0.7


def processor_time(draw: Callable[[], Any]) -> Callable[[], float]:
    """Return what draws a picture, and returns the processor time that took."""

    def timed() -> float:
        start = time.process_time()
        draw()
        return time.process_time() - start

    return timed


class Theirs:
    """VTK's fixed-point ray caster with the points of a preset."""

    def __init__(self, volume: vm.Volume, medium: Any, camera: Any) -> None:
        import pyvista
        import vtk

        spacing = np.ptp(volume.grid.bounds, axis=1) / volume.grid.shape
        low = volume.grid.bounds[:, 0] + 0.5 * spacing
        values = volume.array("ct").astype(np.float32)
        grid = pyvista.ImageData(dimensions=values.shape, spacing=spacing, origin=low)
        grid["ct"] = values.astype(np.int16).ravel(order="F")
        colors, opacities = vtk.vtkColorTransferFunction(), vtk.vtkPiecewiseFunction()
        for x, color, opacity in zip(
            medium.values, medium.colors, medium.opacities[:, 0], strict=True
        ):
            shown = color / opacity if opacity else 0.0 * color
            colors.AddRGBPoint(x, *shown)
            opacities.AddPoint(x, -np.expm1(-opacity))
        look = vtk.vtkVolumeProperty()
        look.SetColor(colors)
        look.SetScalarOpacity(opacities)
        look.SetScalarOpacityUnitDistance(float(medium.path_length))
        look.SetInterpolationType(vtk.VTK_LINEAR_INTERPOLATION)
        look.ShadeOn()
        look.SetAmbient(1.0 - SHADING)
        look.SetDiffuse(SHADING)
        look.SetSpecular(0.0)
        self.mapper = vtk.vtkFixedPointVolumeRayCastMapper()
        self.mapper.SetInputData(grid)
        self.mapper.AutoAdjustSampleDistancesOff()
        self.mapper.SetImageSampleDistance(1.0)
        self.mapper.SetSampleDistance(float(spacing.min()))
        actor = vtk.vtkVolume()
        actor.SetMapper(self.mapper)
        actor.SetProperty(look)
        self.plotter = pyvista.Plotter(off_screen=True, window_size=(PIXELS, PIXELS))
        self.plotter.renderer.AddVolume(actor)
        self._aim(volume, camera)

    def _aim(self, volume: vm.Volume, camera: Any) -> None:
        bounds = volume.grid.bounds
        middle, size = bounds.mean(axis=1), float(np.linalg.norm(np.ptp(bounds, axis=1)))
        incl, phi = np.radians([camera.incl, camera.phi])
        towards = np.array([-np.sin(phi) * np.sin(incl), -np.cos(phi) * np.sin(incl), np.cos(incl)])
        up = np.array([np.sin(phi) * np.cos(incl), np.cos(phi) * np.cos(incl), np.sin(incl)])
        view = self.plotter.camera
        view.position, view.focal_point, view.up = middle + 3 * size * towards, middle, up
        view.parallel_projection, view.parallel_scale = True, 0.5 * camera.width
        self.plotter.renderer.ResetCameraClippingRange()

    def draw(self) -> Any:
        """Draw once."""
        self.plotter.render_window.Render()
        return self.plotter

    def picture(self) -> np.ndarray:
        """Return the picture, 8 bits."""
        return self.plotter.screenshot(return_img=True)


def main() -> None:
    """Print the times of all, and their ratios to PyVista and to no error control."""
    import real_data

    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--preset", nargs="+", default=["skin_and_bone", "bone"])
    parser.add_argument("--repeat", type=int, default=7)
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    volume = real_data.load("cranium")
    for name in options.preset:
        medium = getattr(vm.presets, name)(volume, shading=SHADING)
        camera = vm.Orthographic(75, 30, width=300.0, resolution=PIXELS)
        theirs = Theirs(volume, medium, camera)

        def ours(tolerance: Any, medium: Any = medium, camera: Any = camera) -> Any:
            return vm.render(volume, medium, camera, tolerance=tolerance, device="cpu")

        draws = {"VTK": theirs.draw}
        draws |= {f"{t}": (lambda t=t: ours(t)) for t in (None, 1e-2, 1e-3)}
        timed = {key: processor_time(draw) for key, draw in draws.items()}
        seconds = take_turns(timed, dict.fromkeys(timed, options.repeat))
        rows = []
        for key, own in seconds.items():
            by = [ratios(own, seconds[other])["round"] for other in ("VTK", "None")]
            rows.append([key, f"{1e3 * summary(own)['median']:.0f}", *(f"{r:.2f}" for r in by)])
        print(table([name, "median ms", "over VTK", "over None"], rows), flush=True)
        if options.pictures:
            from PIL import Image

            options.pictures.mkdir(parents=True, exist_ok=True)
            Image.fromarray(theirs.picture()).save(options.pictures / f"{name}-vtk.png")
            ours(1e-3).save(str(options.pictures / f"{name}.png"))


if __name__ == "__main__":
    main()
