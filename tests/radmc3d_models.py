"""Small models of RADMC-3D, one per kind of grid."""

from __future__ import annotations

import numpy as np

from radmc3d_directory import put_field, put_grid, put_species

PI = np.pi
X = [np.linspace(-1.5e15, 1.5e15, n + 1) for n in (8, 5, 6)]
EVEN = [np.linspace(-1.5e15, 1.5e15, n + 1) for n in (4, 6, 8)]
FLAGS = [1, 0, 0, 1, *8 * [0], *5 * [0], 0, 1, *8 * [0], *13 * [0]]
TREE = [np.array([0.0, 1.0, 2.0]) * 1e13, np.arange(3.0) * 1e13, np.arange(5.0) * 1e13]
LAYERS = [[0, 2, 2, 2, 2, 3, 3], [1, 1, 2, 1, 2, 2, 2], [0, 4, 1, 1, 1, 1, 8]]
R = np.geomspace(1e13, 1e15, 13)
THETA = np.concatenate([np.linspace(0.4, PI / 2, 9), [1.9, 2.3]])
PHI = np.linspace(0, 2 * PI, 11)
ENCODINGS = ("text", "binary", "records")


def values(count, seed=0):
    """Return numbers of many sizes, and of all digits."""
    rng = np.random.default_rng(seed)
    return rng.choice([1, 1, 1, -1], count) * 10 ** rng.uniform(-30, 5, count)


def regular(directory, encoding="text", **options):
    put_grid(directory, X, encoding=encoding)
    put_field(directory, "gas_density", values(240), encoding=encoding, **options)
    put_field(directory, "gas_velocity", *values((3, 240), 1), encoding=encoding, **options)
    return directory


def tree(directory, encoding="text"):
    put_grid(directory, TREE, flags=FLAGS, encoding=encoding)
    leaves = FLAGS.count(0)
    put_species(directory, "dust_density", *values((2, leaves)), encoding=encoding)
    put_species(directory, "dust_temperature", values(leaves), encoding=encoding, ending="dat")
    return directory


def layered(directory, encoding="text"):
    put_grid(directory, EVEN, layers=LAYERS, encoding=encoding)
    put_field(directory, "gas_temperature", values(192 + 144 + 64 + 64), encoding=encoding)
    return directory


def spherical(directory, encoding="text"):
    put_grid(directory, [R, THETA, PHI], coordinates=100, encoding=encoding)
    put_field(directory, "numberdens_co", values(1200), encoding=encoding)
    put_field(directory, "gas_velocity", *values((3, 1200), 1), encoding=encoding)
    return directory


MODELS = {"regular": regular, "octree": tree, "layers": layered, "spherical": spherical}


def same(found, expected):
    """Assert that arrays have the same bits."""
    np.testing.assert_array_equal(found, expected)
    assert found.dtype == expected.dtype
