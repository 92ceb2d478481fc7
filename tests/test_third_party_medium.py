"""A medium of a third party, one class, has all that those of the package have."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest

import voluminous as vm
from voluminous.expressions import Expression
from voluminous.media.context import Feature, MediumSample
from voluminous.media.details import Colors
from voluminous.movies import fade

mpl.use("Agg")


class Bump(vm.Medium):
    """A parabolic shell: j, α ∝ 1 - ((x - center) / width)² around a centre."""

    def __init__(self, expr, center, width, color, opacity, path_length="auto"):
        self.expr = Expression(expr)
        self.names = self.expr.names
        self.center, self.width, self.path_length = center, width, path_length
        self.color, self.opacity = color, opacity
        self.channels, self.grey = len(color), True

    def coefficients(self, fields, context):
        """Return j and α per unit length."""
        x, number, ops = context.evaluate(self.expr, fields), context.number, context.ops
        z = (x - number(self.center)) / number(self.width)
        inside = 1.0 - z * z
        shape = ops.where(inside > 0.0, inside, 0.0 * z) * number(1.0 / self.path_length)
        return MediumSample([number(h) * shape for h in self.color], [number(self.opacity) * shape])

    def ranges(self, fields, context):
        """Return intervals that hold j and α: the formulas are the same."""
        return self.coefficients(fields, context)

    def features(self):
        """Return the expression, and the colour at its values."""
        return (Feature(self.expr, colors=Colors([self.center], [self.color], self.width)),)

    def profile(self, unit, extent):
        """Return the shape over the expression."""
        z = np.linspace(-1.0, 1.0, 101)
        return self.center + self.width * z, 1.0 - z * z

    def key(self):
        """Return what identifies it."""
        return ("Bump", self.expr.text, *map(str, self.arguments().values()))


def ball():
    """Return a volume whose field is the distance from its centre."""
    volume = vm.Volume(vm.CartesianGrid.uniform(24, (-1, 1)))
    volume["a"] = "sqrt(x**2 + y**2 + z**2)"
    return volume


BUMP = Bump("a", 0.6, 0.2, (1.0, 0.5, 0.0), 0.8)
CAMERA = vm.Orthographic(30, 40, resolution=8)


def test_its_path_length_is_measured():
    calibrated = BUMP.calibrated(ball())
    # Two thirds of 0.4, where the slope is one; cells are 0.08.
    assert calibrated.path_length == pytest.approx(0.4 * 2 / 3, rel=0.05)
    assert BUMP.path_length == "auto"


def test_it_is_drawn_over_its_expression():
    axes = BUMP.plot(ball())
    axes.figure.canvas.draw()
    red = next(line for line in axes.lines if len(line.get_xdata()))
    x, medium = np.asarray(red.get_xdata()), BUMP.calibrated(ball())
    np.testing.assert_allclose(red.get_ydata(), medium(x)[0][0], rtol=1e-12)
    assert BUMP.plot().get_xlabel() == "a"  # of one path length, without a volume
    assert BUMP._repr_png_().startswith(b"\x89PNG")


def test_its_pictures_have_guaranteed_bounds():
    image = vm.render(ball(), BUMP, CAMERA, bounds=True)
    assert np.all(image.lower <= image.intensity + 1e-6)
    assert np.all(image.upper >= image.intensity - 1e-6)
    assert np.max(image.upper - image.lower) < 0.02 * image.intensity.max()


def test_its_pictures_have_a_colour_bar():
    from voluminous.image.scales import scales_of

    (scale,) = scales_of(vm.render(ball(), BUMP, CAMERA), {})
    assert scale.label == "a"
    # As bright as can be at the centre; the middle of an entry is beside it.
    assert scale.colormap(scale.norm(0.6)) == pytest.approx((1.0, 0.5, 0.0, 1.0), abs=1e-2)


def test_it_fades():
    medium, volume = BUMP.calibrated(ball()), ball()
    frames = fade(medium, vm.Gaussian("a", 0.2, 0.05, (0.0, 0.0, 1.0), 0.1, 1.0), 5)
    depths = [vm.render(volume, one, CAMERA).optical_depth.mean() for one in (frames[0], medium)]
    assert depths[0] == depths[1]
    last = frames[3].components()[0]
    depth = vm.render(volume, last, CAMERA, precision="double").optical_depth.mean()
    assert depth == pytest.approx(0.25 * depths[0], rel=1e-3)
