"""Random volumes and media, each as the package and as its twin has it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

import voluminous as vm
from contracts.bundle import Bundle, on_a_sphere
from twin import post_classified as twin

RAYS = 64
COLORS = ((1.0, 0.5, 0.2), (0.1, 0.4, 0.9))


@dataclass
class Scene:
    """A volume, a medium, and rays; `parts` is the medium of the twin."""

    volume: vm.Volume
    medium: vm.Medium
    parts: list[Any]
    origins: np.ndarray
    directions: np.ndarray
    start: bool = False
    fields: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def camera(self):
        return Bundle(self.origins, self.directions, start=self.start)

    def exact(self, background=0.0):
        """Return what the twin makes of it."""
        grid = self.volume.grid
        return twin.bundle(
            grid.edges,
            self.fields,
            self.parts,
            self.origins,
            self.directions,
            start=self.start,
            background=background,
        )

    def render(self, **options):
        """Return intensity (R, channel), optical depth (R, channel) and claimed error (R,)."""
        camera = self.camera
        image = vm.render(self.volume, self.medium, camera, scheme="post-classified", **options)
        channels = self.medium.channels

        def rows(plane):
            flat = camera.flat(plane)
            return np.broadcast_to(flat.reshape(len(flat), -1), (len(flat), channels))

        error = camera.flat(image.error[..., None])
        return rows(image.intensity), rows(image.optical_depth), error


def make_volume(shape, seed, even=True):
    """Return a volume of random fields a and b, positive, that both precisions can tell."""
    rng = np.random.default_rng(seed)
    if even:
        edges = [
            np.linspace(low, low + n * 0.7, n + 1)
            for low, n in zip((-1, 0.3, -2), shape, strict=True)
        ]
    else:
        widths = [rng.uniform(0.2, 1.5, n) for n in shape]
        edges = [np.concatenate([[0.0], np.cumsum(w)]) - 1.3 for w in widths]
    fields = {
        name: 10 ** rng.uniform(-0.5, 0.5, shape).astype(np.float32).astype(float) for name in "ab"
    }
    fields = {name: a.astype(np.float32).astype(float) for name, a in fields.items()}
    return vm.Volume(vm.CartesianGrid(*edges), fields), fields


def make_rays(grid, seed):
    """Return rays through points of a grid: any, along axes, in planes of centres and in faces."""
    rng = np.random.default_rng(seed)
    low, high = grid.bounds.T
    origins = rng.uniform(low, high, (RAYS, 3))
    directions = on_a_sphere(RAYS, seed)
    directions[:6] = np.vstack([np.eye(3), -np.eye(3)])
    directions[6:12] = directions[:6]
    for k in range(6, 12):
        origins[k] = [
            rng.choice(np.concatenate([e[1:-1], c])) if len(e) > 2 else c[0]
            for e, c in zip(grid.edges, grid.centers, strict=True)
        ]
    directions[12:18, rng.integers(3)] = 0.0
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return origins, directions


def gaussians(rng):
    """Two shells of one field: one kernel for all widths, depths and colours."""
    made, parts = [], []
    for color, kind in zip(COLORS, (vm.Gaussian, vm.Rectangle), strict=True):
        center = rng.uniform(0.4, 2.5)
        width = 10 ** rng.uniform(-4, 0)
        opacity = 10 ** rng.uniform(-4, 0.5) / min(width, 1.0)
        gain = 1.0 / min(width, 1.0)
        made.append(kind("a", center, width, [gain * c for c in color], opacity, 1.0))
        name = "gaussian" if kind is vm.Gaussian else "rectangle"
        glow = [gain * c for c in color]
        parts.append(twin.Shell(lambda f: f["a"], center, width, glow, [opacity], name))
    return made[0] + made[1], parts


def surfaces(rng):
    """Two levels of a product of two fields."""
    levels, opacity = sorted(rng.uniform(0.2, 3.0, 2)), rng.uniform(0, 0.95)
    medium = vm.Isosurface("a*b", level=list(levels), color=COLORS, opacity=opacity)
    parts = [
        twin.Surface(lambda f: f["a"] * f["b"], level, color, [opacity])
        for level, color in zip(levels, COLORS, strict=True)
    ]
    return medium, parts


def thick_surface(rng):
    """A surface with a width, and a shell of another scalar."""
    level, width = rng.uniform(0.5, 2.0), 10 ** rng.uniform(-3, -0.3)
    opacity, center = rng.uniform(0, 0.95), rng.uniform(-0.3, 0.3)
    medium = vm.Isosurface("a", level, COLORS[0], opacity, width)
    medium += vm.Gaussian("log10(b)", center, 0.1, COLORS[1], 0.3, 1.0)
    parts = [
        twin.Surface(lambda f: f["a"], level, COLORS[0], [opacity], width),
        twin.Shell(lambda f: np.log10(f["b"]), center, 0.1, COLORS[1], [0.3]),
    ]
    return medium, parts


def coefficients(rng):
    """Emissivities and extinctions by expressions, two channels, one extinction each."""
    medium = vm.Coefficients(["a", "a*b + 0.1"], ["b", "0.3*a**2"])
    return medium, [
        twin.Smooth(lambda f: ([f["a"], f["a"] * f["b"] + 0.1], [f["b"], 0.3 * f["a"] ** 2]))
    ]


def ramp(a, b, k=1.0):
    """Emit a, absorb k b."""
    return [a, a * a], k * b


def function(rng):
    """A Python function of both fields with a parameter."""
    k = 10 ** rng.uniform(-3, 1)
    medium = vm.Medium.from_function(ramp, ["a", "b"], 2, parameters={"k": k})
    return medium, [twin.Smooth(lambda f: ([f["a"], f["a"] ** 2], [k * f["b"]]))]


MEDIA = {
    "shells": gaussians,
    "surfaces": surfaces,
    "thick surface": thick_surface,
    "coefficients": coefficients,
    "function": function,
}


def make_scene(kind, shape, seed, *, even=True, start=False):
    """Return a random scene of a kind."""
    volume, fields = make_volume(shape, seed, even)
    medium, parts = MEDIA[kind](np.random.default_rng(seed + 1))
    origins, directions = make_rays(volume.grid, seed + 2)
    return Scene(volume, medium, parts, origins, directions, start, fields)
