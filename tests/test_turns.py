"""What turns, or is cut, between two nodes of a panel: found, not taken for what the nodes show."""

import numpy as np
import pytest

import voluminous as vm

GRID = vm.CartesianGrid([-0.5, 0.5, 1.5], [-0.5, 0.5, 1.5], [-0.5, 0.5])
# Along the diagonal from centre to centre, u from 0 to 1; the fields go on constant on both sides.
DIAGONAL = vm.Orthographic.looking((1, 1, 0), width=1e-3, resolution=1, center=(0.5, 0.5, 0))
U = (np.arange(1_000_000) + 0.5) / 1_000_000
TURN = 2 * U - 3 * U**2  # rises to 1/3 at u = 1/3: beside the nodes 0, 1/4, 1/2
PRECISIONS = pytest.mark.parametrize("precision", ["single", "double"])


def quadratic(first, middle, last):
    """Values at four corners, for first (1-u)² + 2 middle u (1-u) + last u²."""
    return np.array([[[first], [middle]], [[middle], [last]]], float)


VOLUME = vm.Volume(GRID, a=quadratic(0, 1, -1), b=quadratic(0, 0, 1), c=quadratic(0, 0.5, 1))


def drawn(medium, precision):
    image = vm.render(VOLUME, medium, DIAGONAL, precision=precision)
    return image.intensity.item(), image.error.item()


@PRECISIONS
@pytest.mark.parametrize("half", [0.1, 0.5, 2.0])
def test_a_rectangle_whose_edge_is_passed_and_passed_again_between_nodes(half, precision):
    center = 1 / 3 - 0.02 - half
    inside = [np.mean(np.abs(x - center) <= half) for x in (TURN, TURN[0], TURN[-1])]
    truth = np.sqrt(2) * inside[0] + np.sqrt(0.5) * (inside[1] + inside[2])
    found, error = drawn(vm.Rectangle("a", center, half, 1.0, 0.0, 1.0), precision)
    assert abs(found - truth) <= min(error, 1e-3 * truth)


@PRECISIONS
@pytest.mark.parametrize(("level", "width"), [(0.3, 0.2), (0.25, 0.4)])
def test_a_surface_with_a_width_in_which_the_scalar_turns(level, width, precision):
    within = np.clip(TURN, level - width / 2, level + width / 2)
    crossed = np.abs(np.diff(within)).sum() / width
    found, error = drawn(vm.Isosurface("a", level, 1.0, 0.4, width), precision)
    assert abs(found - (1 - 0.6**crossed)) <= min(error, 1e-3)


@PRECISIONS
@pytest.mark.parametrize(
    ("level", "gate", "shown"), [(0.04, 0.15, 1), (0.04, 0.25, 0), (0.3, 0.54, 1), (0.5, 0.69, 1)]
)
def test_a_gate_that_opens_near_a_bent_crossing(level, gate, shown, precision):
    # The surface b = u² = level is where c = u = √level: on one side of the gate, never half.
    surface = vm.Isosurface("b", level, 1.0, 0.4, where=f"c > {gate}")
    found, _ = drawn(surface, precision)
    assert found == pytest.approx(0.4 * shown, abs=1e-6)  # one crossing, to rounding
    thin = vm.Gaussian("b", level, 1e-3, 1.0, 0.0, 1e-3 * np.sqrt(2 * np.pi), where=f"c > {gate}")
    truth = shown / np.sqrt(2 * level)  # the length over the slope 2u
    # Curvature within the shell: σ² times the second derivative of 1/(2 √level).
    assert drawn(thin, precision)[0] == pytest.approx(truth, abs=2e-3)


@PRECISIONS
def test_a_shell_of_a_logarithm_between_nothing_and_nothing(precision):
    # The field is 40 u (1-u): zero at both ends, and beyond the shell at all nodes between.
    hump = vm.Volume(GRID, a=quadratic(0, 20, 0))
    shell = vm.Gaussian("log10(a)", 0.0, 0.05, 1.0, 0.0, 1.0)
    image = vm.render(hump, shell, DIAGONAL, precision=precision)
    x = np.log10(40 * U * (1 - U))
    truth = np.sqrt(2) * np.mean(np.exp(-0.5 * (x / 0.05) ** 2))
    # Tolerance 1e-3 of the maximum, which this pixel is.
    assert image.intensity.item() == pytest.approx(truth, rel=1e-3)


@PRECISIONS
@pytest.mark.parametrize("middle", [0.2, 0.9, 3.0])
def test_of_an_opaque_cell_the_front_shows(middle, precision):
    """A source function of the same mean in both halves: that they agree says nothing."""
    volume = vm.Volume(GRID, c=quadratic(1, middle, 1))
    medium, inside = (
        vm.Coefficients("200*c", "200"),
        vm.Perspective((0, 0, 0), (1, 1, 0), 1e-4, resolution=1),
    )
    image = vm.render(volume, medium, inside, precision=precision)
    s = np.sqrt(2) * U  # from the corner at u = 0, where the observer is
    source = (1 - U) ** 2 + 2 * middle * U * (1 - U) + U**2
    truth = np.sqrt(2) * np.mean(200 * source * np.exp(-200 * s))
    truth += np.exp(-200 * np.sqrt(2))
    off = abs(image.intensity.item() - truth)
    # Of the sum over U: 3e-4 of a path length per point.
    assert off <= min(image.error.item(), 1e-3 * truth) + 1e-4


@PRECISIONS
def test_a_surface_in_a_glow_is_as_sure_as_it_is_right(precision):
    """What is in front of the surface and what behind is known when panels are narrow."""
    rng = np.random.default_rng(2)
    volume = vm.Volume(vm.CartesianGrid.uniform(6, (0, 1)), a=rng.random((6, 6, 6)))
    volume["b"] = "a + 0.3*x"
    medium = vm.Isosurface("a", 0.5, 1.0, 0.4) + vm.Gaussian("b", 0.5, 0.3, 1.0, 2.0, 0.3)
    camera = vm.Orthographic(40, 25, width=1.4, resolution=12)
    image = vm.render(volume, medium, camera, precision=precision)
    exact = vm.render(volume, medium, camera, tolerance=1e-7, precision="double")
    brightest = exact.intensity.max()
    assert image.error.max() < 5e-3 * brightest  # it was a third
    assert exact.error.max() < 1e-4 * brightest
    off = np.abs(image.intensity - exact.intensity).max(axis=-1)
    assert np.mean(off <= image.error.reshape(off.shape)) >= 0.99


@pytest.mark.parametrize("depth", [10, 1000, 10000])
def test_a_deep_plateau_in_the_tail_of_a_shell_is_not_left_out(depth):
    """So many path lengths at nearly five σ in front of a shell that is crossed once."""
    width, sigmas = 1.0 / depth, 4.85
    z = np.concatenate([np.linspace(0, 1, 9), 1 + width * np.arange(1, 13)])
    f = np.full((1, 1, 20), sigmas)
    f[..., 8:] = np.linspace(sigmas, -1.4 * sigmas, 12)
    volume = vm.Volume(vm.CartesianGrid([0, 1], [0, 1], z), f=f)
    medium = vm.Gaussian("f", 0, 1, 1.0, 0.0, path_length=1.2 * sigmas * width / 11)
    camera = vm.Orthographic(0, 0, width=0.9, resolution=1)
    image = vm.render(volume, medium, camera)
    exact = vm.render(volume, medium, camera, tolerance=1e-9, precision="double")
    off = abs(image.intensity.item() - exact.intensity.item())
    assert off <= image.error.item() <= 1e-3 * exact.intensity.item()


def test_what_is_behind_is_no_surer_than_its_rounding():
    """A third is no number of single precision, nor is what 1e-8 takes off one."""
    volume = vm.Volume(vm.CartesianGrid.uniform(4, (0, 1)), a=np.ones((4, 4, 4)))
    medium = vm.Coefficients("0", "1e-8 * a")
    image = vm.render(volume, medium, vm.Orthographic(20, 30, resolution=8), background=1 / 3)
    off = np.abs(image.intensity[..., 0] - np.exp(-image.optical_depth[..., 0]) / 3)
    assert np.all(off <= image.error.reshape(off.shape))


@pytest.mark.parametrize(
    "medium",
    [
        # The tails of an opaque shell are opaque too: five σ apart, one hides the other.
        vm.Gaussian("a", 1.2, 1e-3, (1, 0.5, 0.2), 0.9, 3e-4)
        + vm.Gaussian("a", 1.205, 1e-3, (0.1, 0.1, 1), 0.9, 3e-4),
        vm.Gaussian("a", 1.2, 0.01, (1, 0.5, 0.2), 0.5, 0.03),
    ],
    ids=["two opaque shells", "thin shell"],
)
def test_errors_are_told_for_thin_shells_of_smooth_fields(medium):
    volume = vm.Volume(vm.CartesianGrid.uniform(20, (-1, 1)))
    volume["a"] = "exp(0.5*sin(3*x + y) + 0.4*cos(4*y - z) + 0.5*sin(2*z*x + 1))"
    camera = vm.Orthographic(40, 25, resolution=40)
    image = vm.render(volume, medium, camera, precision="double")
    exact = vm.render(volume, medium, camera, precision="double", tolerance=1e-6)
    off = np.abs(image.intensity - exact.intensity).max(axis=-1)
    brightest = exact.intensity.max()
    told = image.error.reshape(off.shape) + 1e-6 * brightest
    assert np.mean(off <= told) >= 0.99
    assert off.max() <= 2e-3 * brightest
