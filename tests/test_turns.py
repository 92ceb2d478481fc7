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
