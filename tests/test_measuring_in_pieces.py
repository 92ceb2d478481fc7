"""Measurements chunk by chunk: the numbers of the whole, and no field is ever read as a whole."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from test_confined_walk import CAMERAS, UNEVEN, UNIFORM
from test_observe import CO
from test_streaming import large_file
from test_streaming_trees import GRIDS as REFINED
from voluminous.deferred import Deferred, Pieces
from voluminous.errors import InputError, MemoryNeededError

RNG = np.random.default_rng(3)
OBLIQUE = CAMERAS["oblique"]
# Sums over chunks have another order than those over all cells: a few roundings of their terms.
ROUNDING = {"rtol": 1e-12, "atol": 1e-13}
PIECES = {"memory": "1 GiB"}


def arrays(grid):
    """Return a density, a velocity, and a field of both signs that is missing in some cells."""
    found = {"density": RNG.uniform(0.1, 1, grid.shape).astype(np.float32)}
    for axis in "xyz":
        found[f"velocity_{axis}"] = RNG.normal(size=grid.shape).astype(np.float32)
    field = RNG.normal(size=grid.shape)
    field[RNG.uniform(size=grid.shape) < 0.2] = np.nan
    if len(grid.shape) == 3:
        field[4:8, 4:, 4:] = np.nan  # a whole chunk
    return {**found, "signed": field}


class Counted:
    """A field of which boxes are read, and counted; as a whole it cannot be read."""

    def __init__(self, array, chunk):
        self.array, self.boxes = array, []
        pieces = Pieces(self.read, (chunk,) * 3)
        self.deferred = Deferred(self.load, array.dtype, pieces=pieces)

    def read(self, low, high, level):
        self.boxes.append((tuple(low), tuple(high)))
        return self.array[tuple(map(slice, low, high))]

    def load(self):
        raise AssertionError("a field was read as a whole")


@pytest.fixture
def volumes(monkeypatch):
    """Return a function of a grid: the volume in memory, that in chunks of 4³, and its fields."""
    monkeypatch.setattr("voluminous.store.FieldStore.side", 4)
    monkeypatch.setattr("voluminous.large.view.VolumeView.widest", 4)

    def make(grid):
        whole = vm.Volume(grid, arrays(grid))
        counted = {name: Counted(whole.array(name), 4) for name in whole}
        parts = vm.Volume(grid, {name: field.deferred for name, field in counted.items()})
        for one in (whole, parts):
            one.set_unit("density", "g / cm3")
            for axis in "xyz":
                one.set_unit(f"velocity_{axis}", "km / s")
        return whole, parts, counted

    return make


def same(whole, parts):
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_array_equal(other.intensity, one.intensity)
        assert (other.unit, other.intensity_unit) == (one.unit, one.intensity_unit)
        assert np.nanmax(np.abs(one.intensity)) > 0


@pytest.mark.parametrize(
    ("grid", "camera"),
    [
        *((UNIFORM, camera) for camera in ("oblique", "along x", "from inside")),
        (UNEVEN, "oblique"),
        pytest.param(UNEVEN, "along x", marks=pytest.mark.exhaustive),
        pytest.param(UNEVEN, "from inside", marks=pytest.mark.exhaustive),
    ],
)
def test_maps_along_rays_have_the_bits_of_the_whole(grid, camera, volumes):
    whole, parts, counted = volumes(grid)
    camera = CAMERAS[camera]

    def agree(function, *args, **options):
        found = function(whole, *args, **options), function(parts, *args, **PIECES, **options)
        same(*([one] if isinstance(one, vm.Image) else list(one) for one in found))

    agree(vm.column, "density", camera)
    agree(vm.column, "signed", camera, samples=2)  # with missing values
    agree(vm.column, "log10(signed)", camera, weight="density")  # undefined where it is negative
    agree(vm.column, "density * los(velocity)", camera)
    agree(vm.moments, "density", camera, precision="single", n=4)
    for how in ("max", "min"):
        agree(vm.project, "log10(signed)", camera, how, depth=True)
    agree(vm.project, "los(velocity)", camera, "max", unit="m/s")
    agree(vm.project, "density > 0.9 g / cm3", camera, "first")
    agree(vm.project, "signed", camera, "mean")
    assert all(field.boxes for field in counted.values())


@pytest.mark.parametrize("scheme", ["first-order", "pre-integrated"])
def test_surfaces_of_optical_depth_have_the_bits_of_the_whole(scheme, volumes):
    whole, parts, _ = volumes(UNIFORM)
    medium = vm.Coefficients(["density / (1 g/cm3)"] * 2, ["density / (1 g/cm3)", 0.5])
    surfaces = [
        vm.tau_surface(volume, medium, OBLIQUE, 0.7, scheme=scheme, precision="single", **options)
        for volume, options in ((whole, {}), (parts, PIECES))
    ]
    same(*([surface.depth] for surface in surfaces))
    np.testing.assert_array_equal(*(surface.points for surface in surfaces))
    assert np.isnan(surfaces[0].points).any()  # rays beside the surface


def test_totals_read_every_chunk_once(volumes):
    whole, parts, counted = volumes(UNEVEN)
    quantities = {"mass": "density", "signed": "signed", "p": "density * los(velocity)"}
    options = {
        "where": "norm(velocity) < 2 km/s",
        "clip": "sphere((0, 0, 0), 10)",
        "camera": OBLIQUE,
    }
    one, other = (
        vm.measure(whole, quantities, **options),
        vm.measure(parts, quantities, **options, **PIECES),
    )
    for name in (*quantities, "volume"):
        a, b = (getattr(m, name) if name == "volume" else m[name] for m in (one, other))
        np.testing.assert_allclose(getattr(b, "value", b), getattr(a, "value", a), **ROUNDING)
        assert getattr(a, "unit", None) == getattr(b, "unit", None)
    assert (other.cells, other.missing) == (one.cells, one.missing)
    assert other.missing["signed"] > 0
    chunks = int(np.prod([-(-n // 4) for n in UNEVEN.shape]))
    for field in counted.values():
        assert len(field.boxes) == len(set(field.boxes)) == chunks
        assert all(max(b - a for a, b in zip(*box, strict=True)) <= 4 for box in field.boxes)


def test_chunks_beside_a_region_are_not_read(volumes):
    whole, parts, counted = volumes(UNIFORM)
    region = "sphere((-0.5, -0.4, 0), 0.3)"
    one, other = (
        vm.measure(v, "density", clip=region, **o) for v, o in ((whole, {}), (parts, PIECES))
    )
    np.testing.assert_allclose(other["density"].value, one["density"].value, **ROUNDING)
    assert other.cells == one.cells
    assert 0 < len(counted["density"].boxes) < np.prod([-(-n // 4) for n in UNIFORM.shape])


def test_exact_maps_and_apertures(volumes):
    whole, parts, _ = volumes(UNEVEN)
    camera = vm.Orthographic(30, 40, width=3, resolution=20)
    options = {"aperture": "circle((0, 0), 0.5)", "maps": True, "camera": camera}
    one = vm.measure(whole, ["density", "signed"], **options)
    other = vm.measure(parts, ["density", "signed"], **options, **PIECES)
    for name in one:
        np.testing.assert_allclose(
            *(getattr(m[name], "value", m[name]) for m in (other, one)), **ROUNDING
        )
        maps = (m.maps[name].intensity for m in (other, one))
        np.testing.assert_allclose(*maps, **ROUNDING)
    columns = (
        vm.column(v, "signed", camera, weight="density", method="exact", **o).intensity
        for v, o in ((parts, PIECES), (whole, {}))
    )
    # Quotients of sums: where little of a pixel is covered both are small.
    np.testing.assert_allclose(*columns, rtol=1e-9)


def test_missing_values_are_hidden_in_first_order(volumes):
    whole, parts, _ = volumes(UNIFORM)
    medium = vm.Coefficients("signed**2", "density / (1 g/cm3)")
    options = {"scheme": "first-order"}
    one = vm.render(whole, medium, OBLIQUE, **options)
    other = vm.render(parts, medium, OBLIQUE, **options, **PIECES)
    np.testing.assert_array_equal(other.intensity, one.intensity)
    np.testing.assert_array_equal(other.transparency, one.transparency)
    assert other.provenance["missing"] == one.provenance["missing"]


def test_components_of_vectors_are_drawn(volumes):
    whole, parts, _ = volumes(UNIFORM)
    shell = vm.Gaussian("los(velocity)", 0.5, 0.2, "red", 0.4, path_length=0.5)
    for camera in (OBLIQUE, CAMERAS["from inside"]):
        for options in ({"scheme": "first-order"}, {"tolerance": None}, {}):
            one = vm.render(whole, shell, camera, **options)
            other = vm.render(parts, shell, camera, **options, **PIECES)
            np.testing.assert_array_equal(other.intensity, one.intensity)


@pytest.mark.parametrize(("scheme", "channels"), [("first-order", 20), ("post-classified", 6)])
def test_many_channels_read_every_chunk_once(scheme, channels, volumes):
    """They are drawn in two groups."""
    whole, parts, counted = volumes(UNIFORM)
    rho = "density / (1 g/cm3)"
    medium = vm.Coefficients(
        [f"{rho} + {k}" for k in range(1, channels + 1)],
        [f"{rho} * {k}" for k in range(1, channels + 1)],
    )
    options = {"scheme": scheme, "tolerance": 1e-3 if scheme == "post-classified" else None}
    one = vm.render(whole, medium, OBLIQUE, **options)
    vm.render(parts, medium, OBLIQUE, **options, **PIECES)  # which looks at some cells beforehand
    counted["density"].boxes.clear()
    other = vm.render(parts, medium, OBLIQUE, **options, **PIECES)
    # Chunks that are drawn again are kept.
    assert len(counted["density"].boxes) == np.prod([-(-n // 4) for n in UNIFORM.shape])
    np.testing.assert_array_equal(other.intensity, one.intensity)
    np.testing.assert_array_equal(other.optical_depth, one.optical_depth)


@pytest.fixture
def cloud(volumes):
    """Return the same gas in memory and in chunks, and what emits: dust, a line, and both."""
    whole, parts, counted = volumes(UNIFORM)
    unit = vm.CartesianGrid(*UNIFORM.edges, unit="pc")
    found = []
    for volume in (whole, parts):
        fields = {n: volume._fields.pieces(n) and counted[n].deferred for n in volume}
        other = vm.Volume(unit, {n: f or whole.array(n) for n, f in fields.items()})
        for name, own in whole.units.items():
            other.set_unit(name, own or None)
        found.append(other)
    dust = vm.Dust("density * 1e-20", 15.0, vm.Opacity.power_law(3.5, 870.0, 1.8))
    gas = vm.Lines(
        "density / (1 g) * 1e-1",
        CO,
        temperature=12,
        velocity="velocity",
        turbulence=0.5 * u.km / u.s,
    )
    return *found, {"dust": dust, "line": gas, "both": dust + gas}


@pytest.mark.parametrize("camera", ["oblique", "from inside"])
def test_dust_and_lines_are_observed_in_chunks(camera, cloud):
    whole, parts, media = cloud
    channels = {"velocities": vm.channels(-4, 4, 7, line="1-0")}
    drawn = {"line": {"scheme": "first-order"}, "both": {}, "dust": {}}
    for name in drawn if camera == "oblique" else ["line", "dust"]:
        options = drawn[name]
        axis = {"wavelengths": [350, 870, 1300]} if name == "dust" else channels
        one = vm.observe(whole, media[name], CAMERAS[camera], **axis, **options)
        other = vm.observe(parts, media[name], CAMERAS[camera], **axis, **options, **PIECES)
        np.testing.assert_array_equal(other.intensity, one.intensity)
        assert one.intensity.max() > 0


def test_spectra_and_many_channels(cloud, monkeypatch):
    whole, parts, media = cloud
    given = {"wavelengths": [350, 870], "distance": 140 * u.pc, "tolerance": 1e-2}
    for more in ({}, {"aperture": 1 * u.pc}):
        fluxes = (
            vm.spectrum(v, media["dust"], **given, **more, **o).flux
            for v, o in ((parts, PIECES), (whole, {}))
        )
        np.testing.assert_array_equal(*fluxes)
    # Channels that do not fit into the memory together are drawn in several passes.
    axis = {"velocities": vm.channels(-4, 4, 30, line="1-0"), "scheme": "first-order"}
    camera = OBLIQUE.replace(resolution=64)
    one = vm.observe(whole, media["line"], camera, **axis)
    drawn = []
    for memory in ("1 GiB", "100 MiB"):
        monkeypatch.setattr(
            "voluminous.observing.cubes.render",
            lambda *a, **o: drawn.append(1) or vm.render(*a, **o),
        )
        other = vm.observe(parts, media["line"], camera, memory=memory, **axis)
        np.testing.assert_array_equal(other.intensity, one.intensity)
        drawn.append(0)
    assert drawn.index(0) == 1  # once
    assert len(drawn) > 4


def probed(probe):
    """Return the numbers of a probe; hidden cells have some coefficients that do not count."""
    found = {f.name: getattr(probe, f.name) for f in fields(probe) if f.name != "provenance"}
    del found["fields"], found["scalars"]
    points = vars(found.pop("points"))
    found |= {f"points.{k}": v for k, v in (points | points["scalars"] | points["fields"]).items()}
    del found["points.fields"], found["points.scalars"]
    return {**found, **probe.fields, **probe.scalars, "j": probe.j[~probe.hidden]}


@pytest.mark.parametrize("camera", ["oblique", "from inside"])
def test_probes_read_the_chunks_along_a_ray(camera, volumes):
    whole, parts, counted = volumes(UNEVEN)
    camera = CAMERAS[camera]
    pixel = tuple(n // 2 for n in camera.frame(UNEVEN).pixels)
    shell = vm.Gaussian("density", 0.5, 0.2, "red", 0.4, path_length=0.5)
    many = [f"(density / (1 g/cm3))**{k}" for k in range(20)]
    for medium, options in (
        (shell, {"scheme": "first-order"}),
        (shell, {"tolerance": None}),
        (shell, {}),
        (vm.Coefficients(many, "density / (1 g/cm3)"), {"scheme": "first-order"}),
        (vm.Coefficients("signed**2", 0.5), {"scheme": "first-order"}),
    ):
        also = {"also": ["log10(signed)", "los(velocity)"]}
        one = vm.probe(whole, medium, camera, pixel, **also, **options)
        vm.render(parts, medium, camera, **options, **PIECES)
        counted["density"].boxes.clear()
        other = probed(vm.probe(parts, medium, camera, pixel, **also, **options, **PIECES))
        for name, value in probed(one).items():
            np.testing.assert_array_equal(other[name], value, err_msg=name)
        # Limits of the picture are remembered: nothing else is read.
        assert len(set(counted["density"].boxes)) < 0.7 * np.prod(
            [-(-n // 4) for n in UNEVEN.shape]
        )
    assert one.hidden.any()


@pytest.mark.parametrize("name", ["octree", "pinwheel", "holes"])
def test_refined_grids_are_measured_in_parts(name, monkeypatch):
    monkeypatch.setattr("voluminous.store.FieldStore.leaves", 64)
    monkeypatch.setattr("voluminous.large.view.VolumeView.widest", 4)
    volume = vm.Volume(REFINED[name], arrays(REFINED[name]))
    camera = vm.Orthographic(35, 50, resolution=24)

    def agree(function, *args):
        found = function(volume, *args), function(volume, *args, **PIECES)
        same(*([one] if isinstance(one, vm.Image) else list(one) for one in found))

    agree(vm.column, "signed", camera)
    agree(vm.moments, "density", camera)
    agree(vm.project, "density > 0.9", camera, "first")
    exact = (vm.column(volume, "signed", camera, method="exact", **o) for o in ({}, PIECES))
    np.testing.assert_allclose(*(image.intensity for image in exact), **ROUNDING)
    totals = [
        vm.measure(volume, ["density", "signed"], "norm(velocity) < 2", camera, **options)
        for options in ({"clip": "sphere((0.5, 0.5, 0.5), 1)"}, {})
        for options in (options, {**options, **PIECES})
    ]
    for one, other in zip(totals[::2], totals[1::2], strict=True):
        np.testing.assert_allclose(list(other.values()), list(one.values()), **ROUNDING)
        assert (other.cells, other.missing) == (one.cells, one.missing)
    medium = vm.Coefficients("density", 0.5)
    probes = (
        probed(vm.probe(volume, medium, camera, (12, 12), scheme="first-order", **options))
        for options in ({}, PIECES)
    )
    for one, other in zip(*(found.values() for found in probes), strict=True):
        np.testing.assert_array_equal(other, one)


def test_what_cannot_be_measured_in_chunks_is_refused(volumes):
    _, parts, _ = volumes(UNIFORM)
    calls = {
        "measure": lambda q, **o: vm.measure(parts, [q], **o),
        "column": lambda q, **o: vm.column(parts, q, OBLIQUE, **o),
        "project": lambda q, **o: vm.project(parts, q, OBLIQUE, **o),
    }
    for call in calls.values():
        with pytest.raises(InputError, match=r"gradmag\(density\).*whole field"):
            call("gradmag(density)", **PIECES)
        with pytest.raises(InputError, match="number of bytes"):
            call("density", memory="much")
        with pytest.raises(MemoryNeededError, match="Allow that"):
            call("density", memory="1 MB")
    for name in ("column", "project"):
        with pytest.raises(InputError, match="infinite"):
            calls[name]("1 / (signed - signed)", **PIECES)
    sphere = vm.Volume(vm.SphericalGrid([0, 1, 2]), density=np.ones((2, 1, 1)))
    with pytest.raises(InputError, match="Cartesian"):
        vm.measure(sphere, "density", **PIECES)


MEASURED = """
import sys
import voluminous as vm

def peak():  # what getrusage tells includes the parent's
    status = open("/proc/self/status").read().splitlines()
    return int(next(line.split()[1] for line in status if line.startswith("VmHWM"))) << 10

camera = vm.Orthographic(35, 50, width=900, resolution=200)
calls = {
    "measure": lambda v, **o: vm.measure(v, {"q": "a * x"}, "a > 0.1", **o),
    "exact": lambda v, **o: vm.column(v, "a * x", camera, method="exact", **o),
    "rays": lambda v, **o: vm.column(v, "a * x", camera, **o),
    "max": lambda v, **o: vm.project(v, "a", camera, depth=True, **o),
}
call = calls[sys.argv[2]]
call(vm.Volume(vm.CartesianGrid.uniform(8, (0, 1)), a="x"), memory="1 GiB")
before = peak()
call(vm.open(sys.argv[1]), memory="300 MiB")
print(peak() - before)
"""


@pytest.mark.exhaustive
@pytest.mark.skipif(sys.platform != "linux", reason="memory is told by /proc")
@pytest.mark.parametrize("what", ["measure", "exact", "rays", "max"])
def test_memory_does_not_depend_on_the_volume(tmp_path, what):
    # 512 MiB, of which less is in memory at any time than is allowed.
    path = large_file(tmp_path, 512)
    command = [sys.executable, "-c", MEASURED, str(path), what]
    told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=500)
    assert int(told.stdout) < 300 << 20
