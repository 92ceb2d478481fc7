"""VTK's fixed-point ray caster on a thin shell around the centre of a cube."""

from __future__ import annotations

import math

import numpy as np
import vtk
from vtk.util import numpy_support

LEVELS = 32767  # the mapper looks its tables up with 15-bit integers


class VtkShell:
    """A Gaussian shell of the distance from the centre; `draw` returns seconds."""

    def __init__(self, radius, level, sigma, color, opacity, path, pixels, frame, distance):
        self.cell = 2.0 / radius.shape[0]
        self.most = float(radius.max())
        data = vtk.vtkImageData()
        data.SetDimensions(*radius.shape)
        data.SetSpacing(*[self.cell] * 3)
        data.SetOrigin(*[0.5 * self.cell - 1.0] * 3)
        scalars = np.rint(radius * (LEVELS / self.most)).astype(np.uint16).ravel(order="F")
        data.GetPointData().SetScalars(numpy_support.numpy_to_vtk(scalars, deep=True))
        self.mapper = vtk.vtkFixedPointVolumeRayCastMapper()
        self.mapper.SetInputData(data)
        self.mapper.AutoAdjustSampleDistancesOff()
        self.mapper.SetImageSampleDistance(1.0)
        self.mapper.SetSampleDistance(self.cell * distance)
        volume = vtk.vtkVolume()
        volume.SetMapper(self.mapper)
        volume.SetProperty(self._look(level, sigma, color, opacity, path))
        self.window = self._window(volume, pixels, frame)

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
        return pixels.reshape(ny, nx, -1)[..., :3] / 255

    def _look(self, level, sigma, color, opacity, path):
        colors, opacities = vtk.vtkColorTransferFunction(), vtk.vtkPiecewiseFunction()
        colors.AddRGBPoint(0, *color)
        colors.AddRGBPoint(LEVELS, *color)
        nodes = level + sigma * np.linspace(-6, 6, 241)
        opacities.AddPoint(0, 0)
        for x, z in zip(nodes, np.linspace(-6, 6, 241), strict=True):
            tau = opacity * math.exp(-0.5 * z * z)
            opacities.AddPoint(x * LEVELS / self.most, -math.expm1(-tau))
        opacities.AddPoint(LEVELS, 0)
        look = vtk.vtkVolumeProperty()
        look.SetColor(colors)
        look.SetScalarOpacity(opacities)
        look.SetScalarOpacityUnitDistance(path)
        look.SetInterpolationType(vtk.VTK_LINEAR_INTERPOLATION)
        look.ShadeOff()
        return look

    def _window(self, volume, pixels, frame):
        renderer = vtk.vtkRenderer()
        renderer.AddVolume(volume)
        window = vtk.vtkRenderWindow()
        window.SetOffScreenRendering(1)
        window.SetMultiSamples(0)
        window.SetSize(pixels, pixels)
        window.AddRenderer(renderer)
        incl, phi = math.radians(60), math.radians(30)
        camera = renderer.GetActiveCamera()
        camera.SetPosition(
            -8 * math.sin(phi) * math.sin(incl),
            -8 * math.cos(phi) * math.sin(incl),
            8 * math.cos(incl),
        )
        camera.SetFocalPoint(0, 0, 0)
        camera.SetViewUp(
            math.sin(phi) * math.cos(incl), math.cos(phi) * math.cos(incl), math.sin(incl)
        )
        camera.ParallelProjectionOn()
        camera.SetParallelScale(frame / 2)
        renderer.ResetCameraClippingRange()
        return window
