"""Hashes: any change of a byte of an array shows, and of whatever else pictures depend on."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import voluminous as vm
from voluminous.digest import content_key, digest


@pytest.mark.parametrize("shape", [(), (0,), (7,), (3, 4, 5), (300, 300, 200)])
@pytest.mark.parametrize("dtype", ["f4", "f8", ">f4", "u1", "i2", "?"])
def test_equal_contents_have_equal_digests_and_any_change_shows(shape, dtype):
    values = np.random.default_rng(0).integers(0, 2, shape).astype(dtype)
    before = digest(values)
    assert digest(values.copy()) == before
    flat = np.ascontiguousarray(values).reshape(-1)
    for place in {0, flat.size // 2, flat.size - 1} if flat.size else ():
        changed = flat.copy()
        changed[place] = 1 - changed[place]
        assert digest(changed.reshape(shape)) != before


def test_parts_that_change_places_show():
    values = np.repeat(np.arange(4, dtype="f4"), 2 << 20)  # parts of 8 MiB
    assert digest(values) != digest(values[::-1].copy())


# What a notebook may have: functions, classes, modules of one's own, and values of packages.
NOTEBOOK = """
import abc, enum, functools, sys
from dataclasses import dataclass
sys.path.insert(0, sys.argv[1])
import numpy as np, voluminous as vm, own_tools
from astropy import units as u
from matplotlib import colors
from voluminous.digest import content_key

class Kind(enum.Enum):
    BRIGHT = 1

class Base(abc.ABC):
    @abc.abstractmethod
    def go(self): ...

@dataclass
class Finish(Base):
    kind: Kind = Kind.BRIGHT
    def go(self):
        return self.__class__ in {"a", "b", "c"} or self.cached
    @functools.cached_property
    def cached(self): return own_tools.scaled(2)
    @classmethod
    def make(cls): return cls()

def local(image):
    from scipy.ndimage import gaussian_filter
    import own_tools
    return own_tools.scaled(gaussian_filter(image, 1)) * (2 * u.pc)

def even(n): return n == 0 or odd(n - 1)
def odd(n): return n > 0 and even(n - 1)

values = [
    Finish(), Finish.make, local, even, {1.0: "a"}, np.arange(3), np.datetime64("2020"), 2 * u.pc,
    np.array(["2020-01-01"], "M8[D]"), np.ma.array([1, 2], mask=[0, 1]), np.float32(0.1),
    colors.PowerNorm(2, 0, 1), colors.ListedColormap(["red", "blue"]), u.Unit("km/s"),
    vm.Gaussian("a", 0.5, 0.1, (1.0, 0.5, 0.2), 0.3, path_length=0.2 * u.pc), vm.Orthographic(60),
    vm.models.sphere(4), vm.Medium.from_function(lambda a: (own_tools.scaled(a), a), ["a"], 1),
]
print(*map(content_key, values))
own_tools.FACTOR = 4
print(*map(content_key, values))
"""


def test_keys_are_the_same_in_all_processes_and_follow_modules(tmp_path):
    (tmp_path / "own_tools.py").write_text("FACTOR = 3\ndef scaled(x): return FACTOR * x\n")
    lines = []
    for seed in ("1", "2"):
        environment = {"PYTHONHASHSEED": seed, "PYTHONPATH": str(Path(vm.__file__).parents[1])}
        command = [sys.executable, "-W", "error", "-c", NOTEBOOK, str(tmp_path)]
        told = subprocess.run(
            command, env={**os.environ, **environment}, capture_output=True, check=True, text=True
        )
        lines.append([line.split() for line in told.stdout.splitlines()])
    assert lines[0] == lines[1]
    before, after = lines[0]
    assert len({*before}) == len(before)
    changed = [k for k, pair in enumerate(zip(before, after, strict=True)) if len({*pair}) > 1]
    assert changed == [0, 1, 2, 17]  # that call the function whose factor is another one


def test_numbers_count_to_the_last_bit():
    following = np.nextafter(0.1, 1)
    values = [0.1, following, np.float32(0.1), 1, 1.0, True, "1", 0.0, -0.0, [1, 2], (1, 2)]
    assert len({content_key(value) for value in values}) == len(values)
    assert content_key([0.1]) == content_key([0.1])
