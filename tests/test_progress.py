"""Progress of everything that takes long: reported to a function, shown or not shown."""

import warnings

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from voluminous.drawing import api
from voluminous.rendering import options

GRID = vm.CartesianGrid.uniform(8, (-1, 1), unit="pc")
VOLUME = vm.Volume(GRID, density=np.random.default_rng(1).uniform(1, 2, GRID.shape) / u.cm**3)
MEDIUM = vm.Gaussian("density", 1.5, 0.1, 1.0, 1.0, 1.0)
CAMERA = vm.Orthographic(resolution=8)
POINTS = np.random.default_rng(1).normal(size=(50, 3))
BALLS = vm.SphericalGrid([0.0, 0.5, 1.0], [0.0, 1.5, np.pi], [0.0, 2 * np.pi], unit="pc")

LONG = {
    "render": lambda p: vm.render(VOLUME, MEDIUM, CAMERA, progress=p),
    "column": lambda p: vm.column(VOLUME, "density", CAMERA, progress=p),
    "exact column": lambda p: vm.column(VOLUME, "density", CAMERA, method="exact", progress=p),
    "moments": lambda p: vm.moments(VOLUME, "density", CAMERA, "density", progress=p),
    "tau_surface": lambda p: vm.tau_surface(VOLUME, MEDIUM, CAMERA, 0.1, progress=p),
    "probe": lambda p: vm.probe(VOLUME, MEDIUM, CAMERA, (4, 4), progress=p),
    "measure": lambda p: vm.measure(VOLUME, "density", progress=p),
    "maps": lambda p: vm.measure(VOLUME, "density", camera=CAMERA, maps=True, progress=p),
    "resample": lambda p: VOLUME.resample(BALLS, progress=p),
    "from_particles": lambda p: vm.Volume.from_particles(POINTS, 1.0, progress=p),
    "from_particles of a mesh": lambda p: vm.Volume.from_particles(
        POINTS, 1.0, volume=0.1, progress=p
    ),
}


@pytest.mark.parametrize("name", LONG)
def test_a_function_hears_of_the_end(name):
    reports = []
    LONG[name](lambda done, total: reports.append((done, total)))
    assert reports[-1][0] == reports[-1][1] > 0
    assert all(0 <= done <= total for done, total in reports)


@pytest.mark.parametrize("name", LONG)
def test_a_bar_where_it_is_asked_for_and_nowhere_else(name, capsys):
    LONG[name](False)
    LONG[name](None)
    assert capsys.readouterr().err == ""
    LONG[name](True)
    assert "%|" in capsys.readouterr().err


@pytest.mark.parametrize("name", LONG)
def test_anything_else_is_refused(name):
    with pytest.raises(vm.InputError, match="progress must be True, False, None or a function"):
        LONG[name]("yes")


def test_a_function_may_cancel():
    class EnoughError(Exception):
        pass

    def stop(done, total):
        raise EnoughError

    for long in LONG.values():
        with pytest.raises(EnoughError):
            long(stop)
        long(None)  # the next is unharmed


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ({"antialias": "adaptive"}, "samples=4"),
        ({"precision": "double"}, "'single'"),
        ({"bounds": True}, "image.error"),
        ({"tolerance": 1e-6}, "1e-3"),
    ],
)
def test_slow_choices_are_named_once(option, words, monkeypatch, caplog):
    asked, named = [], set()
    monkeypatch.setattr(api, "name_slow_choices", lambda seconds, **chosen: asked.append(chosen))
    vm.render(VOLUME, MEDIUM, CAMERA)
    vm.render(VOLUME, MEDIUM, CAMERA, **option)
    usual, slow = asked
    options.name_slow_choices(60.0, named, **usual)
    options.name_slow_choices(1.0, named, **slow)
    assert not caplog.records
    for _ in range(2):
        options.name_slow_choices(60.0, named, **slow)
    (record,) = caplog.records
    assert words in record.getMessage()


def test_a_bar_in_a_notebook(monkeypatch):
    import sys
    from types import SimpleNamespace

    from voluminous.progress import _is_seen

    kernel = SimpleNamespace(config={"IPKernelApp": {}})
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: kernel))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert _is_seen()
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: None))
    assert not _is_seen()
