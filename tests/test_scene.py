"""Scenes: what the file says is what is rendered; what it cannot say is refused with its place."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from voluminous.files import MissingPathError
from voluminous.scene.settings import dumps, loads

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.toml"))
GAUSSIAN = {
    "type": "gaussian",
    "expr": "log10(density)",
    "center": 3.5,
    "sigma": 0.05,
    "color": [0.4, 0.4, 0.8],
    "opacity": 0.001,
    "path_length": "2.5e16 cm",
}
CORE = {
    "volume": {"model": "prestellar_core", "resolution": 12},
    "medium": [GAUSSIAN, {**GAUSSIAN, "center": 4.0, "color": [0.89, 0.47, 0.06]}],
    "camera": {"incl": 60, "phi": 30, "width": "0.25 pc", "resolution": 8},
    "render": {"precision": "double"},
}
SPHERE = {
    "volume": {"model": "sphere", "resolution": 4},
    "medium": [{"type": "coefficients", "emissivity": "inside", "extinction": "0.1 * inside"}],
    "camera": {"resolution": 4},
}


def changed(scene, section, **keys):
    """Return a scene's settings with keys of a section set, or removed where None."""
    old = scene.get(section, {})
    new = {k: v for k, v in {**old, **keys}.items() if v is not None}
    return {**scene, section: new}


def written(tmp_path, text):
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


# A scene is what Python says


def test_a_scene_is_the_same_picture_as_python():
    length = 2.5e16 * u.cm
    medium = vm.Gaussian("log10(density)", 3.5, 0.05, (0.4, 0.4, 0.8), 0.001, length)
    medium += vm.Gaussian("log10(density)", 4.0, 0.05, (0.89, 0.47, 0.06), 0.001, length)
    camera = vm.Orthographic(60, 30, width=0.25 * u.pc, resolution=8)
    volume = vm.models.prestellar_core(12)
    expected = vm.render(volume, medium, camera, precision="double").intensity
    np.testing.assert_array_equal(vm.Scene(CORE).render().intensity, expected)


PROJECTION = """
[volume]
model = "prestellar_core"
resolution = 8

[project]
quantity = "x * density"
how = "min"
slab = ["0.02 pc", "0.05 pc"]

[camera]
resolution = [12, 8]
"""


def test_a_scene_of_a_projection(tmp_path):
    scene = vm.Scene(loads(PROJECTION), tmp_path)
    image = scene.render(precision="double", progress=False)
    camera = vm.Orthographic(resolution=(12, 8))
    how = {"slab": (0.02 * u.pc, 0.05 * u.pc), "precision": "double"}
    wanted = vm.project(scene.volume(), "x * density", camera, "min", **how)
    np.testing.assert_array_equal(image.intensity, wanted.intensity)
    image.save(tmp_path / "a.png")
    again = vm.Scene.load(tmp_path / "a.png")
    assert again.to_dict()["project"] == scene.to_dict()["project"]
    (tmp_path / "a.toml").write_text(again.dumps())
    loaded = vm.Scene.load(tmp_path / "a.toml").render(progress=False, precision="double")
    np.testing.assert_array_equal(loaded.intensity, wanted.intensity)
    # A film of it is grey, with one range for all frames.
    path = [camera, camera.replace(phi=90)]
    frames = vm.movie(scene.volume(), None, path, tmp_path / "f.png", project=scene.projection)
    pictures = [vm.Image.load(frame) for frame in frames]
    assert pictures[0].provenance["how"] == "min"
    for name, message in (("how", "unknown how"), ("quantity", "quantity is missing")):
        sections = loads(PROJECTION)
        sections["project"] = (
            {**sections["project"], "how": "most"} if name == "how" else {"how": "max"}
        )
        with pytest.raises(vm.VoluminousError, match=message):
            vm.Scene(sections)
    with pytest.raises(vm.InputError, match="no objects"):
        vm.Scene({**loads(PROJECTION), "object": [vm.Axes(length=1)]})


def test_objects_in_place_of_tables():
    medium = vm.Gaussian("x", 0.0, 1.0 * u.cm, (1.0, 0.5), 0.1, 1 * u.pc)
    camera = vm.Perspective([2, 0, 0] * u.pc, [0, 0, 0] * u.pc, 30, up=(0, 1, 0), resolution=(3, 2))
    scene = vm.Scene({"volume": CORE["volume"], "medium": medium + medium, "camera": camera})
    assert [m["sigma"] for m in scene.to_dict()["medium"]] == ["1.0 cm"] * 2
    again = vm.Scene(loads(scene.dumps()))
    assert again.medium.describe() == scene.medium.describe()
    assert again.camera.describe() == camera.describe()


MEDIA = [
    vm.Gaussian("density", 1.0, 2.0, 0.5, (0.1,), 3.0),
    vm.Rectangle("density", 1.0 / u.cm**3, 2.0, (0.5, 1), (0.1, 0.2), 3 * u.km),
    vm.Table("x + 1", [0, 1, 1, 2], [[0, 1], [1, 0], [1, 1], [0, 0]], [0, 0, 1, 1], 2.0),
    vm.Table("density", [1.0, 2.5] / u.cm**3, ["red", "blue"], [0.1, 0.2], 3 * u.km),
    vm.Colormap("density", "inferno", 1.0, 10.0, 0.3, 1 * u.pc, norm="log"),
    vm.Colormap("density", "inferno", 1.0, 10.0, np.sqrt, 1 * u.pc, samples=16),
    vm.Coefficients(["density", "2 * density"], "1e-3 * density"),
]


@pytest.mark.parametrize("medium", MEDIA, ids=lambda medium: type(medium).__name__)
def test_every_medium_survives_the_file(medium):
    scene = vm.Scene({"volume": CORE["volume"], "medium": [medium]})
    again = vm.Scene(loads(scene.dumps()))
    assert again.medium.key() == medium.key()


def test_derived_fields_and_units():
    derived = {"half": "inside / 2", "far": "half + 2 K"}
    volume = vm.Scene(changed(SPHERE, "volume", derived=derived, units={"inside": "K"})).volume()
    assert volume.fields == ("inside", "half", "far")
    assert volume.units["inside"] == "K"
    np.testing.assert_array_equal(volume.array("half"), volume.array("inside") / 2)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_examples_render(path):
    scene = vm.Scene.load(path).replaced({"camera.resolution": 8, "volume.resolution": 16})
    image = scene.render()
    assert np.all(np.isfinite(image.intensity))
    assert image.intensity.max() > 0


# Files


def test_paths_are_relative_to_the_scene_file(tmp_path, monkeypatch):
    (tmp_path / "data").mkdir()
    vm.models.sphere(4).save(tmp_path / "data" / "a.h5")
    vm.Image(np.full((4, 4, 1), 7.0)).save(tmp_path / "data" / "stars.npz")
    settings = {
        **SPHERE,
        "volume": {"path": "a.h5", "fields": ["inside"]},
        "render": {"background": "stars.npz", "scheme": "first-order"},
    }
    scene = vm.Scene(settings, tmp_path / "data")
    scene.save(tmp_path / "scene.toml")
    assert 'path = "data/a.h5"' in (tmp_path / "scene.toml").read_text()
    monkeypatch.chdir("/")
    again = vm.Scene.load(tmp_path / "scene.toml")
    np.testing.assert_array_equal(again.render().intensity, scene.render().intensity)
    assert again.render().intensity[0, 0, 0] == 7.0  # the corner shows the background


def test_file_options_reach_the_reader(tmp_path):
    np.save(tmp_path / "a.npy", np.ones((2, 3, 4)))
    volume = {"path": "a.npy", "name": "rho", "axes": "zyx", "bounds": ["-1 pc", "1 pc"]}
    scene = vm.Scene({"volume": volume, "medium": [GAUSSIAN]}, tmp_path)
    assert scene.volume().fields == ("rho",)
    assert scene.volume().grid.shape == (4, 3, 2)
    assert scene.volume().unit == u.pc


def test_an_image_carries_its_scene(tmp_path):
    scene = vm.Scene(CORE)
    image = scene.render(scheme="first-order", cutoff=0)
    image.save(tmp_path / "core.png")
    again = vm.Scene.load(tmp_path / "core.png")
    assert again.render_options == {"precision": "double", "scheme": "first-order", "cutoff": 0}
    np.testing.assert_array_equal(again.render().intensity, image.intensity)
    vm.Image(np.ones((1, 1, 1))).save(tmp_path / "other.png")
    with pytest.raises(vm.InputError, match=r"other\.png: this image carries no scene"):
        vm.Scene.load(tmp_path / "other.png")


def test_values_of_python_survive_pictures_and_files(tmp_path):
    for options in (
        {"tolerance": None, "background": (0.1, 0.2, 0.3)},
        {"tolerance": np.float64(0.1), "cutoff": np.float32(0.1), "samples": np.int64(2)},
    ):
        image = vm.Scene(CORE).render(**options)
        image.save(tmp_path / "core.npz")
        given = vm.Scene({**CORE, "render": {"precision": "double", **options}})
        given.save(tmp_path / "core.toml")
        for name in ("core.npz", "core.toml"):
            again = vm.Scene.load(tmp_path / name).render()
            np.testing.assert_array_equal(again.intensity, image.intensity)


def test_what_a_scene_cannot_hold_is_told(tmp_path):
    scene = vm.Scene({**CORE, "render": {"tolerance": 0.1, "background": 0.5}})
    behind = vm.Image(np.ones((8, 8, 3)))
    with pytest.warns(UserWarning, match="scene is without background, which a file cannot hold"):
        image = scene.render(background=behind, tolerance=1e-3, cutoff=None)
    assert image.provenance["scene"]["render"] == {"tolerance": 1e-3}
    with pytest.warns(UserWarning, match="scene is without background"):
        scene.render(background=behind.intensity)


def test_image_options_go_to_formats_that_have_them(tmp_path):
    scene = vm.Scene({**CORE, "image": {"exposure": 2.0, "bits": 16}})
    image = scene.render()
    for name in ("a.png", "a.fits"):
        scene.save_image(image, tmp_path / name)
    shown = vm.Image.load(tmp_path / "a.png").intensity
    # Sixteen bits: half a step is 1/131070.
    np.testing.assert_allclose(shown, image.to_rgb(exposure=2.0), atol=8e-6)
    np.testing.assert_array_equal(vm.Image.load(tmp_path / "a.fits").intensity, image.intensity)


# Changes


def test_replaced_changes_a_copy():
    scene = vm.Scene(CORE)
    scene.volume()
    turned = scene.replaced({"camera.incl": 10, "medium.2.opacity": 0.5, "image.bits": 16})
    assert (scene.camera.incl, turned.camera.incl) == (60, 10)
    assert [m["opacity"] for m in turned.to_dict()["medium"]] == [0.001, 0.5]
    assert turned.volume() is scene.volume()  # not read again
    assert scene.replaced({"volume.resolution": 4}).volume() is not scene.volume()
    assert scene.replaced({"medium": GAUSSIAN}).medium.channels == 3


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ("camra.incl", "unknown section 'camra'; did you mean 'camera'"),
        ("camera.inlc", r"\[camera\]: unknown key 'inlc'; did you mean 'incl'"),
        ("medium.3.opacity", "expected a number from 1 to 2, got '3'"),
        ("medium.opacity", "say which of the 2"),
        ("object.1.width", "'object.1.width': there is none to change, got '1'"),
        ("camera.incl.x", "camera.incl is a value, not a table"),
    ],
)
def test_places_that_do_not_exist(place, expected):
    with pytest.raises(vm.VoluminousError, match=expected):
        vm.Scene(CORE).replaced({place: 1})


# What is refused


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({**SPHERE, "volumes": {}}, "unknown section 'volumes'; did you mean 'volume'"),
        ({"volume": SPHERE["volume"]}, "the section 'medium' is missing"),
        ({**SPHERE, "camera": 3}, r"expected a table \[camera\], got camera = 3"),
        ({**SPHERE, "medium": [3]}, r"expected tables \[\[medium\]\], got 3 as number 1"),
        ({**SPHERE, "volume": {"resolution": 3}}, r"\[volume\]: give path = a file, or model ="),
        (changed(SPHERE, "volume", model="spere"), r"\[volume\]: .*did you mean 'sphere'"),
        (changed(SPHERE, "volume", resoluton=3), r"\[volume\]: .*did you mean 'resolution'"),
        (changed(SPHERE, "volume", fields="a"), "fields belongs to a file"),
        (
            changed(SPHERE, "volume", model=None, resolution=None, path="a.h5", unti="pc"),
            r"\[volume\]: unknown key 'unti'; did you mean 'unit'",
        ),
        (
            changed(SPHERE, "volume", derived={"a": "log10(inside"}),
            r"\[volume.derived\] a: .*never closed",
        ),
        (
            changed(SPHERE, "volume", units={"inside": "KK"}),
            r"\[volume.units\]: 'KK' is not a unit",
        ),
        (changed(SPHERE, "camera", inlc=3), r"\[camera\]: unknown key 'inlc'; did you mean 'incl'"),
        (changed(SPHERE, "camera", incl=True), r"\[camera\]: incl: expected a number.*got True"),
        (changed(SPHERE, "camera", type="fisheye"), r"\[camera\]: unknown type 'fisheye'"),
        (changed(SPHERE, "camera", type="perspective"), r"\[camera\]: position is missing"),
        (changed(SPHERE, "render", shceme="x"), r"\[render\]: unknown key 'shceme'.*'scheme'"),
        (changed(SPHERE, "render", tolerance=2), r"\[render\]: tolerance is the error allowed"),
        (changed(SPHERE, "render", progress="yes"), r"\[render\]: unknown key 'progress'"),
        (changed(SPHERE, "image", strech="log"), r"\[image\]: unknown key 'strech'.*'stretch'"),
        (changed(SPHERE, "image", stretch="lgo"), r"\[image\]: unknown stretch 'lgo'.*'log'"),
        (changed(SPHERE, "image", transparent=1), r"transparent: expected true or false, got 1"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(settings, expected):
    with pytest.raises(vm.VoluminousError, match=expected):
        vm.Scene(settings)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"type": None}, r"\[\[medium\]\] 2: type is missing; there are: .*gaussian"),
        ({"type": "gausian"}, r"\[\[medium\]\] 2: unknown type 'gausian'; did you mean 'gaussian'"),
        ({"sigma": None}, r"\[\[medium\]\] 2: sigma is missing; there may be: expr, center"),
        ({"colour": 1}, r"\[\[medium\]\] 2: unknown key 'colour'; did you mean 'color'"),
        ({"sigma": "wide"}, r"\[\[medium\]\] 2: sigma: expected a number"),
        ({"color": True}, r"\[\[medium\]\] 2: color: expected a name, a number or a list"),
        ({"color": [1.0]}, r"\[\[medium\]\]: media with 1 and 3 channels cannot be added"),
        ({"expr": ["a", True]}, r"\[\[medium\]\] 2: expr: expected an expression"),
        ({"path_length": "2.5e16 cn"}, r"\[\[medium\]\] 2: path_length: 'cn' is not a unit"),
    ],
)
def test_what_is_wrong_with_a_medium(change, expected):
    second = {k: v for k, v in {**GAUSSIAN, **change}.items() if v is not None}
    with pytest.raises(vm.VoluminousError, match=expected):
        vm.Scene({**CORE, "medium": [GAUSSIAN, second]})


def test_errors_of_a_file_name_it(tmp_path):
    with pytest.raises(MissingPathError, match="there is no file"):
        vm.Scene.load(tmp_path / "scene.toml")
    with pytest.raises(vm.FileFormatError, match=r"scene\.toml: not valid TOML.*line 2, column 10"):
        vm.Scene.load(written(tmp_path, "[camera]\nincl = 6 0\n"))
    with pytest.raises(vm.errors.UnknownNameError, match=r"scene\.toml: unknown section 'camra'"):
        vm.Scene.load(written(tmp_path, "[camra]\nincl = 60\n"))
    (tmp_path / "scene.toml").write_bytes(b"\x89PNG\r\n")
    with pytest.raises(vm.FileFormatError, match=r"scene\.toml: expected a scene in TOML.*byte 0"):
        vm.Scene.load(tmp_path / "scene.toml")
    scene = vm.Scene({**SPHERE, "volume": {"path": "none.h5"}}, tmp_path)
    with pytest.raises(MissingPathError, match=r"\[volume\]: there is no file .*none\.h5"):
        scene.volume()


# Quantities and TOML


values = st.recursive(
    st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=50)
@given(st.dictionaries(st.text(), values))
def test_toml_comes_back(tables):
    # The order of keys is no part of a document; NaN is not equal to itself.
    texts = [json.dumps(one, sort_keys=True) for one in (loads(dumps(tables)), tables)]
    assert texts[0] == texts[1]


def test_toml_cannot_hold_everything():
    with pytest.raises(vm.InputError, match="cannot hold"):
        dumps({"a": math})
    with pytest.raises(vm.InputError, match=r"cannot hold 'a\\udcff\.h5', which is no UTF-8"):
        dumps({"path": "a\udcff.h5"})
