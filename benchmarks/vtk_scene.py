"""VTK's CPU ray caster, `vtkFixedPointVolumeRayCastMapper`, on a benchmark scene.

How the scene is said in VTK's terms:

* The points of the image data are the cell centres (the mapper refuses cell data), so VTK's volume
  ends half a cell inside ours.
* Scalars are log10(n) in 15 bits of uint16: the mapper looks its tables up with 15-bit integers
  whatever it is given, and converts float32 at every sample, which costs it time.
* Opacity is per unit distance (our path length). Colours are multiplied by opacity and stored in
  fixed point, thus at most 1: a scene that shines brighter is divided by its `gain`.
* Neighbouring scalars are either taken as constant in a cell (VTK's default, like first order) or
  interpolated linearly.

The time is the mapper's own (`GetTimeToDraw`): casting the rays and handing the result to OpenGL,
without clearing and swapping the window.
"""

from __future__ import annotations

import math

import numpy as np
import vtk
from vtk.util import numpy_support

from scenes import PARSEC, PIXELS, Scene

LEVELS = 32767  # largest 15-bit number
TABLE_NODES = 4001


class VtkScene:
    """One scene, ready to draw; `draw` returns seconds."""

    def __init__(self, scene: Scene, linear: bool):
        """Build data, transfer functions and an off-screen window; nothing is drawn yet."""
        self.scene = scene
        logn = np.log10(scene.density())
        self.low, self.high = float(logn.min()), float(logn.max())
        self.gain = max(1.0, float(scene.source(self._nodes()).max()))
        self.mapper = self._mapper(self._image_data(logn))
        self.window = self._window(self._volume(linear))

    def draw(self) -> float:
        """Draw once; return the seconds the mapper took."""
        self.window.Render()
        return self.mapper.GetTimeToDraw()

    def picture(self) -> np.ndarray:
        """Return the intensity (ny, nx, 3), as well as 8 bits can tell it."""
        grabber = vtk.vtkWindowToImageFilter()
        grabber.SetInput(self.window)
        grabber.ReadFrontBufferOff()
        grabber.Update()
        output = grabber.GetOutput()
        nx, ny, _ = output.GetDimensions()
        pixels = numpy_support.vtk_to_numpy(output.GetPointData().GetScalars())
        return pixels.reshape(ny, nx, -1)[..., :3] * (self.gain / 255)

    def describe(self) -> str:
        """Return the version, the kind of window and the number of threads."""
        version = vtk.vtkVersion.GetVTKVersion()
        threads = self.mapper.GetNumberOfThreads()
        return f"VTK {version}, {self.window.GetClassName()}, {threads} threads"

    def _nodes(self) -> np.ndarray:
        return np.linspace(self.low, self.high, TABLE_NODES)

    def _scalar(self, logn: np.ndarray) -> np.ndarray:
        return (logn - self.low) * (LEVELS / (self.high - self.low))

    def _cell(self) -> float:
        return self.scene.width / self.scene.cells

    def _image_data(self, logn: np.ndarray) -> vtk.vtkImageData:
        data = vtk.vtkImageData()
        data.SetDimensions(*logn.shape)
        data.SetSpacing(*[self._cell()] * 3)
        data.SetOrigin(*[(self._cell() - self.scene.width) / 2] * 3)
        scalars = np.rint(self._scalar(logn)).astype(np.uint16).ravel(order="F")
        data.GetPointData().SetScalars(numpy_support.numpy_to_vtk(scalars, deep=True))
        return data

    def _mapper(self, data: vtk.vtkImageData) -> vtk.vtkFixedPointVolumeRayCastMapper:
        mapper = vtk.vtkFixedPointVolumeRayCastMapper()
        mapper.SetInputData(data)
        mapper.AutoAdjustSampleDistancesOff()
        mapper.SetImageSampleDistance(1.0)
        mapper.SetSampleDistance(self._cell())
        return mapper

    def _volume(self, linear: bool) -> vtk.vtkVolume:
        colors, opacities = vtk.vtkColorTransferFunction(), vtk.vtkPiecewiseFunction()
        nodes = self._nodes()
        source = self.scene.source(nodes) / self.gain
        _, extinction = self.scene.coefficients(nodes)
        for value, color, opacity in zip(self._scalar(nodes), source, extinction, strict=True):
            colors.AddRGBPoint(value, *color)
            # Extinction tau per unit distance is VTK's opacity 1 - exp(-tau) per unit distance.
            opacities.AddPoint(value, -math.expm1(-opacity))
        look = vtk.vtkVolumeProperty()
        look.SetColor(colors)
        look.SetScalarOpacity(opacities)
        look.SetScalarOpacityUnitDistance(self.scene.path_length / PARSEC)
        look.SetInterpolationType(
            vtk.VTK_LINEAR_INTERPOLATION if linear else vtk.VTK_NEAREST_INTERPOLATION
        )
        look.ShadeOff()
        volume = vtk.vtkVolume()
        volume.SetMapper(self.mapper)
        volume.SetProperty(look)
        return volume

    def _window(self, volume: vtk.vtkVolume) -> vtk.vtkRenderWindow:
        renderer = vtk.vtkRenderer()
        renderer.AddVolume(volume)
        self._aim(renderer)
        window = vtk.vtkRenderWindow()
        window.SetOffScreenRendering(1)
        window.SetMultiSamples(0)
        window.SetSize(PIXELS, PIXELS)
        window.AddRenderer(renderer)
        return window

    def _aim(self, renderer: vtk.vtkRenderer) -> None:
        towards, up = self.scene.view()
        camera = renderer.GetActiveCamera()
        camera.SetPosition(*(4 * self.scene.width * towards))
        camera.SetFocalPoint(0, 0, 0)
        camera.SetViewUp(*up)
        camera.ParallelProjectionOn()
        camera.SetParallelScale(self.scene.frame / 2)
        renderer.ResetCameraClippingRange()
