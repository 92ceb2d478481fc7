"""The explorer without a browser: frames, document, session, painter, questions, and its guard."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import re
import threading
import time
import warnings
import zipfile
import zlib
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image as Pillow

import voluminous as vm
from voluminous.calibration.labels import Labels
from voluminous.levels import level_within
from voluminous.scene.settings import loads
from voluminous.store import FieldStore
from voluminous.viewer import frames
from voluminous.viewer.document import Document
from voluminous.viewer.explorer import Explorer
from voluminous.viewer.measures import shown_where
from voluminous.viewer.painter import at_hand, caught_warnings, sampled
from voluminous.viewer.script import IN_MEMORY, keyframes_of, python_of, shortened
from voluminous.viewer.session import QUIET, SIZES, Session
from voluminous.viewer.share import tables_of

GRID = vm.CartesianGrid.uniform(16, (-1, 1))
AXIS = np.linspace(-0.95, 0.95, 16)
VALUES = np.exp(-sum(np.meshgrid(AXIS**2, AXIS**2, AXIS**2, indexing="ij")))
SHELL = vm.Gaussian("a", 0.6, 0.05, (1.0, 0.5, 0.2), 0.3, path_length=0.2)
CORE = vm.Gaussian("a", 0.9, 0.05, (0.2, 0.5, 1.0), 0.3, path_length=0.2)
CAMERA = vm.Orthographic(60, 30, width=2.5, resolution=64)
SHELL_OF_N = vm.Gaussian("n", 1.0, 0.5, (1.0, 0.5, 0.2), 0.3, path_length=0.2)


@pytest.fixture
def volume():
    return vm.Volume(GRID, a=VALUES)


# --- frames ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [1, 2, 3, 5])
@pytest.mark.parametrize("scale", [1.0, 1e-20, 1e20])
def test_exact_frames_keep_eleven_binary_digits(channels, scale):
    rng = np.random.default_rng(channels)
    picture = (10.0 ** rng.uniform(-3, 0, (7, 9, channels)) * scale).astype(np.float32)
    head, payload = frames.float16(picture)
    np.testing.assert_allclose(frames.from_float16(head, payload), picture, rtol=2.0**-11)


@pytest.mark.parametrize("channels", [1, 2, 3, 5])
def test_previews_are_near(channels):
    x, y = np.meshgrid(np.linspace(0, 1, 64), np.linspace(0, 1, 48))
    picture = np.stack([np.exp(-((x - 0.5) ** 2) * 9 - y * k) for k in range(channels)], axis=-1)
    head, payload = frames.log_jpeg(picture)
    error = np.abs(frames.from_log_jpeg(head, payload) / picture - 1)
    # Half a code of 254 for 16 factors of two is 2.2 %; the JPEG adds about as much.
    assert np.median(error) < 0.03
    assert np.quantile(error, 0.99) < 0.12


def test_frames_of_odd_values():
    picture = np.zeros((4, 4, 3))
    picture[0, 0], picture[1, 1], picture[2, 2] = np.nan, np.inf, -1.0
    for encode, decode in (
        (frames.float16, frames.from_float16),
        (frames.log_jpeg, frames.from_log_jpeg),
    ):
        assert np.isfinite(decode(*encode(picture))).all()
        assert not decode(*encode(np.zeros((4, 4, 1)))).any()


@given(st.dictionaries(st.text(), st.integers() | st.text()), st.binary())
def test_blocks_are_taken_apart_again(message, payload):
    assert frames.unpacked(frames.packed(message, payload)) == (message, payload)


def test_a_preview_is_small():
    core = vm.models.prestellar_core(32)
    image = vm.render(core, vm.suggest_medium(core), vm.Orthographic(60, 30, resolution=400))
    assert len(frames.log_jpeg(image.intensity)[1]) < 40 << 10
    assert len(frames.float16(image.intensity)[1]) < 500 << 10


# --- document -------------------------------------------------------------------------------------


def make_document():
    camera = {k: v for k, v in CAMERA.describe().items() if k != "resolution"}
    return Document({"medium": tables_of(SHELL + CORE), "camera": camera})


def test_changes_are_undone_and_done_again():
    document = make_document()
    start = document.settings
    document.apply([("medium.0.opacity", 0.5)], "opacity")
    document.apply([("medium.1", None)], "remove")
    assert len(document.settings["medium"]) == 1
    assert document.labels == (["opacity", "remove"], [])
    assert document.undo()
    assert document.undo()
    assert document.settings == start
    assert not document.undo()
    assert document.redo()
    assert document.settings["medium"][0]["opacity"] == 0.5
    document.apply([("image.exposure", 2.0)], "exposure")
    assert document.labels == (["opacity", "exposure"], [])


def test_a_gesture_is_one_entry():
    document = make_document()
    for k in range(10):
        document.apply([("medium.0.center", 0.5 + 0.01 * k)], "centre", moving=k < 9)
    document.apply([("medium.0.center", 0.1)], "centre")
    assert document.labels[0] == ["centre", "centre"]


def test_what_pages_do_themselves_makes_no_frame_old():
    document = make_document()
    document.apply([("image.exposure", 2.0)])
    document.apply([("bookmarks", [])])
    assert (document.revision, document.painted) == (2, 0)
    document.apply([("image.exposure", 1.0), ("medium.0.opacity", 0.5)])
    assert document.painted == document.revision == 3
    document.undo()
    assert document.painted == document.revision == 4


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("volume.path", "/etc/passwd", "cannot be changed"),
        ("medium.7.opacity", 0.5, "no '7'"),
        ("medium.0.opacity", -0.5, "opacity"),
        ("medium.0.expr", "__import__('os')", "__import__"),
        ("medium.0.nonsense", 1, "nonsense"),
        ("medium.0.opacity.deep", 1, "no such"),
        ("camera.incl", "north", "incl"),
        ("render.tolerance", -1, "tolerance"),
        ("image.stretch", "wide", "wide"),
        ("project", {"quantity": "a", "how": "most"}, "most"),
        ("project.slab", [0, 1], "quantity is missing"),
        ("slices.at", [1, 2], "3 numbers"),
        ("slices.window", [0, "much"], "number"),
        ("medium", [3], "table"),
    ],
)
def test_what_would_be_wrong_changes_nothing(path, value, message):
    document = make_document()
    before, revision = json.dumps(document.settings), document.revision
    with pytest.raises(vm.VoluminousError, match=message):
        document.apply([("medium.0.opacity", 0.9), (path, value)])
    assert (json.dumps(document.settings), document.revision) == (before, revision)
    assert document.labels == ([], [])


# --- session --------------------------------------------------------------------------------------

EVENTS = st.lists(
    st.tuples(st.sampled_from(["want", "move", "paint", "seen", "lose"]), st.floats(0.0, 0.5)),
    max_size=60,
)


@given(EVENTS)
@settings(max_examples=200)
def test_a_session_never_waits_in_a_queue_and_ends_with_the_last_input(events):
    session, now, frame, number = Session({}), 0.0, 0, 0
    flying: list[int] = []
    displayed = -1

    def paint():
        nonlocal frame, displayed
        if session.wants_preview(now):
            frame += 1
            session.sent(frame, session.wanted, now, 0.02, preview=True)
            flying.append(frame)
            assert session.shown >= displayed
            displayed = session.shown
        elif session.wants_rest(now):
            frame += 1
            session.sent(frame, session.wanted, now, 0.1, preview=False, full=True)
            flying.append(frame)

    for event, wait in events:
        now += wait
        if event in ("want", "move"):
            number += 1
            session.want(now, moving=event == "move", number=number)
        elif event == "paint":
            paint()
        elif event == "seen" and flying:
            session.seen(flying.pop(0), now)
        elif event == "lose":
            flying.clear()
        assert len(session._in_flight) <= 5  # the window, and the one that comes to rest
        assert 0 <= session.level < len(SIZES)
    session.want(now, number=number + 1)
    for _ in range(10):
        now += 3.0
        paint()
        while flying:
            session.seen(flying.pop(0), now)
    assert session.shown == session.wanted == number + 1
    assert session.input == number + 1
    assert session.is_exact


def test_a_slow_kernel_makes_previews_small_and_a_fast_one_large():
    session = Session({}, size=(800, 600))
    for k in range(5):
        session.sent(k, k, 0.3 * k, 0.3, preview=True)
        session.seen(k, 0.1 * k + 0.001)
    assert session.preview_size == (133, 100)
    assert session.first_order
    for k in range(5, 30):
        session.sent(k, k, 0.1 * k, 0.001, preview=True)
        session.seen(k, 0.1 * k + 0.001)
    assert session.preview_size == (800, 600)


def test_a_full_picture_is_exact_only_of_the_newest_wish():
    """Also if the wish came while the last pixels were drawn."""
    session = Session({})
    session.want(0.0)
    session.sent(1, 1, 0.1, 0.02, preview=True)
    session.want(1.0)
    session.sent(2, 1, 1.0, 0.5, preview=False, full=True)
    assert not session.is_exact
    session.seen(2, 1.1)
    assert session.wants_preview(2.0)
    session.sent(3, 2, 2.0, 0.02, preview=True)
    assert session.wants_rest(3.0)
    session.sent(4, 2, 3.0, 0.5, preview=False, full=True)
    assert session.is_exact


def test_more_frames_fly_where_the_way_is_long():
    near, far = Session({}), Session({})
    for k in range(30):
        for session, way in ((near, 0.002), (far, 0.16)):
            session.sent(k, k, float(k), 0.05, preview=True)
            session.seen(k, k + way)
    assert near.window == 1
    assert far.window == 4


def test_nothing_is_painted_for_a_hidden_page():
    session = Session({}, visible=False)
    session.want(0.0)
    assert not session.wants_preview(1.0)
    assert not session.wants_rest(1.0)


def test_nothing_is_painted_for_a_page_without_room():
    session = Session({}, size=(1, 1))
    session.want(0.0)
    assert not session.wants_preview(1.0)
    session.resize((300, 200), 1.0)
    assert session.wants_preview(1.0)


# --- the explorer, with a page that is a list -----------------------------------------------------


class Page:
    """Keeps what it is sent, and says that it has drawn each frame."""

    def __init__(self, explorer, size=(48, 40), leader=True):
        self.messages, self.lock = [], threading.Condition()
        self.client = explorer.connect(self.take)
        self.number = 0
        self.say("hello", protocol=1, size=list(size), scale=1.0, leader=leader)

    def take(self, message, payload):
        json.dumps(message, allow_nan=False)
        with self.lock:
            self.messages.append((message, payload))
            self.lock.notify_all()
        if message["kind"] == "frame":
            self.client.receive({"kind": "seen", "frame": message["number"]})

    def say(self, kind, **rest):
        self.client.receive({"kind": kind, **rest})

    def put(self, kind, **rest):
        self.number += 1
        self.say(kind, n=self.number, **rest)
        return self.number

    def wait(self, condition, seconds=60.0):
        """Return the first message that fits, also of those that have come."""
        end = time.monotonic() + seconds
        with self.lock:
            done = 0
            while True:
                for message, payload in self.messages[done:]:
                    if condition(message):
                        return message, payload
                done = len(self.messages)
                left = end - time.monotonic()
                assert left > 0, [m["kind"] for m, _ in self.messages[-10:]]
                self.lock.wait(left)

    def exact(self, number):
        return self.wait(lambda m: m["kind"] == "frame" and m["exact"] and m["n"] >= number)

    def ask(self, kind, **rest):
        self.number += 1
        self.say(kind, id=self.number, **rest)
        answer = self.number
        return self.wait(lambda m: m["kind"] == "reply" and m["id"] == answer)[0]


@pytest.fixture
def explorer(volume):
    explorer = Explorer(volume, SHELL + CORE, CAMERA)
    yield explorer
    explorer.close()


def test_a_page_is_welcomed_and_gets_a_preview_and_the_exact_picture(explorer, volume):
    page = Page(explorer)
    welcome, _ = page.wait(lambda m: m["kind"] == "welcome")
    assert welcome["volume"]["fields"][0]["name"] == "a"
    assert welcome["volume"]["bounds"] == [[-1, 1]] * 3
    assert welcome["volume"]["name"] == "volume.npz"
    preview, _ = page.wait(lambda m: m["kind"] == "frame")
    assert preview["codec"] == "log-jpeg"
    assert not preview["exact"]
    frame, payload = page.exact(0)
    picture = frames.from_float16(frame, payload)
    image = vm.render(volume, SHELL + CORE, CAMERA.replace(resolution=(48, 40)))
    top = image.intensity.max()
    np.testing.assert_allclose(picture, image.intensity, atol=2e-3 * top, rtol=2.0**-11)
    assert frame["error"] <= 1e-3
    assert frame["exposure"] == pytest.approx(image.exposure, rel=1e-6)
    np.testing.assert_allclose(frame["frame"]["right"], CAMERA.frame(GRID).vectors[1])


BOX = {"kind": "cells", "expr": "a", "low": [-0.3, -0.9, 0.1], "high": [0.71, 0.9, 0.8]}


def test_measures_are_those_of_python(explorer, volume):
    page, patch = Page(explorer), [["measures", []]]
    distance = {"kind": "distance", "points": [[0.1, 0.2, -0.3], [0.4, -0.2, 0.9]]}
    angle = {"kind": "angle", "points": [[1, 0, 0], [0, 0, 0], [1, 1, 0]]}
    region = vm.regions.Box(BOX["low"], BOX["high"])
    shown = page.ask("measure", measure={"kind": "cells", "expr": "a"}, medium=0)
    low, high = 0.6 - 0.05 * np.sqrt(2 * np.log(2)), 0.6 + 0.05 * np.sqrt(2 * np.log(2))
    assert shown["where"] == f"{low:.6g} <= a <= {high:.6g}"
    boxed = page.ask("measure", measure=BOX)
    for reply, options in ((shown, {"where": shown["where"]}), (boxed, {"clip": region})):
        wanted = vm.measure(volume, "a", **options)
        assert (reply["total"], reply["volume"]) == (wanted["a"], wanted.volume)
        assert (reply["min"], reply["max"]) == (wanted.minima["a"], wanted.maxima["a"])
        assert (reply["mean"], reply["cells"]) == (wanted.means["a"], wanted.cells)
    within = np.abs(VALUES - 0.6) <= 0.5 * (high - low)
    assert shown["cells"] == np.count_nonzero(within)
    assert shown["mean"] == pytest.approx(VALUES[within].mean(), rel=1e-12)
    patch[0][1] += [distance, angle, {**BOX, "where": "a > 0.5"}]
    page.say("set", n=1, patch=patch, label="measures")
    assert not [m for m, _ in page.messages if m["kind"] == "notice"]
    # What is copied computes them: the lines below the picture.
    text = page.ask("export", what="python")["text"].partition("picture.png")[2].partition("\n")[2]
    told: dict = {"vm": vm, "volume": volume}
    with contextlib.redirect_stdout(io.StringIO()):
        exec(text, told)
    assert told["distance"] == pytest.approx(1.3)
    assert told["angle"] == pytest.approx(45)
    assert told["cells"].means == vm.measure(volume, "a", "a > 0.5", clip=region).means


NODES = [0.1, 0.3, 0.3, 0.5, 0.8, 0.9]
HEIGHTS = [0.0, 1.0, 0.2, 0.6, 0.1, 0.7]


@pytest.mark.parametrize(
    ("medium", "shown"),
    [
        (vm.Gaussian("a", 0.6, 0.1, [1.0], 0.3), np.exp(-0.5 * ((VALUES - 0.6) / 0.1) ** 2) >= 0.5),
        (vm.Rectangle("a", 0.6, 0.1, [1.0], 0.3, where="x > 0"), np.abs(VALUES - 0.6) <= 0.1),
        (vm.Isosurface("a", [0.7, 0.4]), VALUES >= 0.4),
        (vm.Table("a", NODES, [[1.0]] * 6, HEIGHTS), np.interp(VALUES, NODES, HEIGHTS) >= 0.5),
        (vm.Table("a", NODES, HEIGHTS, [0.0] * 6), np.interp(VALUES, NODES, HEIGHTS) >= 0.5),
        (vm.Colormap("a", "viridis", opacity=lambda place: 1 - place), None),
        (vm.Coefficients("a", "a**2"), 0.5 * VALUES.max() ** 2 <= VALUES**2),
        (Labels("n", [1, 2, 3], visible=[True, False, True]), np.abs(np.rint(4 * VALUES) - 2) == 1),
    ],
)
def test_a_medium_shows_the_cells_at_half_of_its_maximum(volume, medium, shown):
    volume["n"] = np.rint(4 * VALUES)
    found = volume.evaluate(shown_where(medium, volume)) != 0
    if medium.describe().get("where"):
        shown = shown & (GRID.cell_centers()[0].reshape(shown.shape) > 0)
    if shown is None:  # opacity falls from 1 to 0 over the range that is measured
        full = medium.calibrated(volume).range
        shown = np.interp(VALUES, full.values, 1 - full.position) >= 0.5
    # Numbers of the condition have six digits: no value of a cell is that near to a limit.
    assert 0 < np.count_nonzero(found) < found.size
    np.testing.assert_array_equal(found, shown)


def test_what_is_no_measure_is_refused(explorer):
    page = Page(explorer)
    page.say("cancel", of=1)  # counting ends where it is
    assert page.ask("measure", measure=BOX)["error"] == "cancelled"
    assert page.ask("measure", measure=BOX)["cells"] > 0
    wrong = [{"kind": "distance", "points": [[0, 0, 0]]}, {"kind": "area"}, {"kind": "cells"}, 3]
    wrong += [
        {**BOX, "clip": "sphere((0, 0, 0), 1)"},
        {**BOX, "low": [0, 0]},
        {"kind": "cells", "expr": "a", "low": [0] * 3},
    ]
    for one in wrong:
        assert "must be a distance" in page.ask("measure", measure=one)["error"]
    for one, words in (
        ({**BOX, "expr": "b"}, "unknown field 'b'"),
        ({**BOX, "where": "a > 2"}, "no cell"),
        ({**BOX, "low": [3, 0, 0]}, "low must be below high"),
    ):
        assert words in page.ask("measure", measure=one)["error"]


@pytest.mark.parametrize(
    ("camera", "pixels"),
    [
        (vm.Panorama((0.3, 0.1, 0), (0, 0.5, 0), stereo="over-under"), (40, 40)),
        (vm.Panorama((0.3, 0.1, 0), (0, 0.5, 0), projection="cubemap"), (60, 40)),
        (vm.Panorama((0.3, 0.1, 0), (0, 0.5, 0), projection="fulldome"), (40, 40)),
        (vm.Perspective((0, -4, 1), (0, 0, 0), 40, stereo="side-by-side"), (60, 30)),
    ],
)
def test_pictures_of_a_fixed_shape_are_as_large_as_fits(volume, camera, pixels):
    explorer = Explorer(volume, SHELL + CORE, camera)
    page = Page(explorer, size=(61, 40))
    last = page.put("look", camera=explorer.document.settings["camera"], moving=False)
    frame, payload = page.exact(last)
    assert not [m for m, _ in page.messages if m["kind"] == "notice"]
    assert (frame["width"], frame["height"]) == pixels
    picture = frames.from_float16(frame, payload)
    image = vm.render(volume, SHELL + CORE, camera.within((61, 40)))
    assert image.intensity.std() > 0
    np.testing.assert_allclose(picture, image.intensity, atol=2e-3 * image.intensity.max())
    ray = page.ask("probe", x=0.7, y=0.6)
    x, y = ray["pixel"]
    assert (x, y) == (int(0.7 * pixels[0]), int(0.6 * pixels[1]))
    np.testing.assert_allclose(ray["intensity"], picture[y, x], atol=2e-3 * image.intensity.max())
    light = page.ask("highlight", expr="a", low=0.5, high=1.0)
    assert (light["width"], light["height"]) == pixels
    png = Pillow.open(io.BytesIO(base64.b64decode(page.ask("export", what="png")["data"])))
    assert png.size == pixels
    path = {"kind": "keyframes", "cameras": [frame["camera"]] * 2}
    film = page.ask("film", path=path, frames=2, width=30, what="gif")
    assert Pillow.open(io.BytesIO(base64.b64decode(film["data"]))).size[0] == 30
    explorer.close()


def test_surfaces_without_a_width_have_previews_on_slow_machines(volume):
    explorer = Explorer(volume, vm.Isosurface("a", 0.6, "orange"), CAMERA)
    page = Page(explorer)
    page.client.session.first_order = True
    page.exact(page.put("look", camera=explorer.document.settings["camera"], moving=False))
    assert not [m for m, _ in page.messages if m["kind"] == "notice"]
    assert page.client.session.first_order
    explorer.close()


def test_the_last_of_many_inputs_is_what_is_shown(explorer, volume):
    page = Page(explorer)
    for k in range(40):
        last = page.put("look", camera={"type": "orthographic", "incl": k, "phi": 0}, moving=k < 39)
    frame, payload = page.exact(last)
    assert frame["camera"]["incl"] == 39
    camera = vm.Orthographic(39, 0, resolution=(48, 40))
    image = vm.render(volume, SHELL + CORE, camera)
    np.testing.assert_allclose(
        frames.from_float16(frame, payload), image.intensity, atol=2e-3 * image.intensity.max()
    )
    numbers = [m["n"] for m, _ in page.messages if m["kind"] == "frame"]
    assert numbers == sorted(numbers)
    assert len(numbers) < 60


def test_media_are_edited_and_hidden(explorer, volume):
    page = Page(explorer)
    last = page.put("set", patch=[["medium.0.hidden", True]], label="hide")
    frame, payload = page.exact(last)
    image = vm.render(volume, CORE, CAMERA.replace(resolution=(48, 40)))
    np.testing.assert_allclose(
        frames.from_float16(frame, payload), image.intensity, atol=2e-3 * image.intensity.max()
    )
    last = page.put("set", patch=[["medium.1.hidden", True]], label="hide")
    assert not frames.from_float16(*page.exact(last)).any()
    page.put("undo")
    page.put("undo")
    page.wait(lambda m: m["kind"] == "document" and m["redo"] == ["hide", "hide"])
    assert explorer.medium == SHELL + CORE


def test_display_options_paint_nothing(explorer):
    page = Page(explorer)
    page.exact(0)
    count = sum(m["kind"] == "frame" for m, _ in page.messages)
    page.put("set", patch=[["image.exposure", 3.0]], label="exposure")
    page.wait(lambda m: m["kind"] == "document" and m["document"]["image"] == {"exposure": 3.0})
    time.sleep(2 * QUIET)
    assert sum(m["kind"] == "frame" for m, _ in page.messages) == count


def test_a_clicked_pixel_tells_what_probe_tells(explorer, volume):
    page = Page(explorer)
    page.exact(0)
    reply = page.ask("probe", x=0.4, y=0.55)
    assert reply["pixel"] == [19, 22]
    ray = vm.probe(volume, SHELL + CORE, CAMERA.replace(resolution=(48, 40)), (19, 22))
    np.testing.assert_array_equal(reply["intensity"], ray.intensity)
    np.testing.assert_array_equal(reply["fields"]["a"], ray.points.fields["a"])
    np.testing.assert_array_equal(reply["walls"][2:-1], ray.end)
    np.testing.assert_array_equal(np.transpose(reply["accumulated"])[2:-1], ray.gathered)
    np.testing.assert_array_equal(np.transpose(reply["extinction"]), ray.points.alpha)
    light = ray.gathered.sum(axis=1)
    assert ray.begin[0] <= reply["depth"] <= ray.end[-1]
    inside = np.searchsorted(ray.end, reply["depth"])
    assert light[max(inside - 1, 0)] <= 0.5 * light[-1] * 1.0001 <= light[inside] * 1.0002


def cut_values(cut):
    """Return the values of a slice as a page decodes them."""
    data = zlib.decompress(base64.b64decode(cut["data"]))
    return np.frombuffer(data, cut["type"]).reshape(cut["height"], cut["width"])


@pytest.mark.parametrize(
    ("kind", "values"), [("u1", [0, 255]), ("<i2", [-1024, 3071]), ("<u2", [0, 65535])]
)
def test_whole_numbers_of_slices_are_sent_as_such(kind, values):
    grid = vm.CartesianGrid.uniform((2, 3, 4), (0, 1))
    cells = np.random.default_rng(0).choice(values, (2, 3, 4))
    cells[:, 0, 1:3] = values
    explorer = Explorer(vm.Volume(grid, n=cells.astype(np.int32)), SHELL_OF_N, CAMERA)
    cut = Page(explorer).ask("slice", expr="n", axis=0, at=0.75, size=[3, 4])
    assert cut["type"] == kind
    np.testing.assert_array_equal(cut_values(cut), cells[1].T)
    explorer.close()


def decoded(head, payload):
    """Return the numbers of a frame of a projection."""
    if head["codec"] == "float16":
        return frames.from_float16(head, payload)[..., 0]
    codes = np.asarray(Pillow.open(io.BytesIO(payload)))[::-1].astype(float)
    return np.where(
        codes > 0, head["low"] + (head["high"] - head["low"]) * (codes - 1) / 254, -np.inf
    )


def test_a_projection_is_shown_exported_and_left(explorer, volume, tmp_path):
    page = Page(explorer)
    page.exact(0)
    clip = "box((-1, -1, -1), (0.3, 1, 1))"
    page.put("set", patch=[["render.clip", clip]])
    number = page.put("set", patch=[["project", {"quantity": "-1000 * a", "how": "min"}]])
    preview, quick = page.wait(
        lambda m: m["kind"] == "frame" and not m["exact"] and m.get("how") == "min"
    )
    head, payload = page.exact(number)
    image = explorer.scene((48, 40)).render(progress=False)
    wanted = vm.project(volume, "-1000 * a", explorer.camera.within((48, 40)), "min", clip=clip)
    np.testing.assert_array_equal(image.intensity, wanted.intensity)
    truth = wanted.intensity[..., 0]
    np.testing.assert_allclose(
        decoded(head, payload), np.where(np.isnan(truth), -np.inf, truth), rtol=2.0**-11
    )
    assert preview["codec"] == "linear-jpeg"
    # A step of 8 bits, and what JPEG does to edges.
    seen = decoded(preview, quick)
    assert abs(seen[np.isfinite(seen)].min() - np.nanmin(truth)) < 30
    text = page.ask("export", what="python", width=48)["text"]
    volume.save(tmp_path / "volume.npz")
    scope: dict = {}
    code = text.replace("volume.npz", str(tmp_path / "volume.npz"))
    exec(code.replace("picture.png", str(tmp_path / "picture.png")), scope)
    np.testing.assert_array_equal(scope["image"].intensity, wanted.intensity)
    toml = page.ask("export", what="toml")["text"]
    assert "[project]" in toml
    marked = page.ask("export", what="png", width=96, marks=["color_bar"], ground="black")
    assert Pillow.open(io.BytesIO(base64.b64decode(marked["data"]))).width > 96
    error = page.ask("export", what="png", width=96, marks=[], ground="white")["error"]
    assert "save it on black" in error
    film = page.ask("film", path={"kind": "orbit"}, frames=2, width=48, what="png")
    with zipfile.ZipFile(io.BytesIO(base64.b64decode(film["data"]))) as bundle:
        assert len(bundle.namelist()) == 2
    # The deepest cell of the middle ray is in the middle of the volume.
    assert np.linalg.norm(page.ask("probe", x=0.5, y=0.5)["point"]) < 0.2
    page.put("undo")
    assert not explorer.document.settings["project"]
    assert "error" not in page.ask("load", text=toml)
    assert explorer.document.settings["project"]["how"] == "min"


def test_slices_are_no_part_of_what_is_undone(explorer):
    page = Page(explorer)
    page.put("set", patch=[["image.exposure", 2.0]])
    page.put("set", patch=[["slices", {"expr": "a", "at": [0, 0, 0.5], "window": [0, 1]}]])
    page.put("set", patch=[["slices.at", [0, 0.5, 0.5]]])
    page.put("undo")
    settings = explorer.document.settings
    assert "exposure" not in settings["image"]
    assert settings["slices"]["at"] == [0, 0.5, 0.5]
    assert "slices" not in page.ask("export", what="toml")["text"]


def test_histograms_slices_and_suggestions(explorer, volume):
    page = Page(explorer)
    reply = page.ask("histogram", expr="a", bins=64, log=False)
    counts, edges = np.histogram(VALUES, 64)
    assert reply["counts"] == counts.tolist()
    np.testing.assert_allclose(reply["edges"], edges)
    assert page.ask("histogram", expr="a - 1", log=True)["error"].startswith(
        "a - 1 has no positive"
    )
    for axis, cells in ((0, VALUES[5].T), (1, VALUES[:, 5]), (2, VALUES[:, :, 5].T)):
        cut = page.ask("slice", expr="2*a", axis=axis, at=5.5 / 16, size=[16, 16])
        np.testing.assert_array_equal(cut_values(cut), 2 * cells)
    assert "pixels along a side" in page.ask("slice", expr="a", axis=0, at=0.5, size=9999)["error"]
    assert "error" not in page.ask("suggest", name=None)
    assert repr(explorer.medium) == repr(vm.suggest_medium(volume))
    assert "'gold'" in page.ask("suggest", name="gold")["error"]


def test_thumbnails_are_pictures_of_presets(explorer):
    page = Page(explorer)
    presets = page.wait(lambda m: m["kind"] == "welcome")[0]["presets"]
    assert {"bone", "lung"} <= set(presets)
    assert all(hasattr(vm.presets, name) for name in presets)
    reply = page.ask("thumbnail", name=None)
    picture = Pillow.open(io.BytesIO(base64.b64decode(reply["data"])))
    assert picture.size == (96, 80)
    assert np.asarray(picture).std() > 10
    assert "'gold'" in page.ask("thumbnail", name="gold")["error"]


def test_a_thumbnail_is_the_picture_of_its_medium():
    """Also upright: of a ball above the middle."""
    volume = vm.Volume(GRID)
    volume["a"] = "exp(-4 * (x**2 + y**2 + (z - 0.5)**2))"
    camera = vm.Orthographic(80, 30, width=2.5)
    explorer = Explorer(volume, SHELL, camera)
    data = base64.b64decode(Page(explorer, size=(96, 80)).ask("thumbnail", name=None)["data"])
    medium = vm.suggest_medium(volume)
    image = vm.render(volume, medium, camera.replace(resolution=(96, 80)), tolerance=None)
    found = np.asarray(Pillow.open(io.BytesIO(data)))[::-1] / 255.0
    np.testing.assert_allclose(found, image.to_rgb(), atol=0.51 / 255)  # of eight bits
    explorer.close()


def test_a_highlight_is_where_rays_go_through_the_values(explorer):
    """Values above 0.5 are in a sphere of radius sqrt(ln 2) around the middle."""
    page = Page(explorer, size=(100, 100))
    page.put("look", camera={"type": "orthographic", "incl": 0, "phi": 0, "width": 2}, moving=False)
    reply = page.ask("highlight", expr="a", low=0.5, high=1.0)
    assert (reply["width"], reply["height"]) == (100, 100)
    seen = np.frombuffer(base64.b64decode(reply["data"]), np.uint8).reshape(100, 100) / 255.0
    x = (np.arange(100) + 0.5) / 50 - 1
    squares = np.log(2) - x[:, None] ** 2 - x**2
    chord = np.sqrt(np.maximum(squares, 0) / np.log(2))
    # The root of the length is sent. Cells are an eighth wide: at the edge, where the length falls
    # steeply, the sphere of the cubic between them is a little smaller.
    inside = chord > 0.4
    np.testing.assert_allclose(seen[inside] ** 2, chord[inside], atol=0.1)
    assert not seen[squares < -0.03].any()
    assert not any(
        np.frombuffer(
            base64.b64decode(page.ask("highlight", expr="a", low=5, high=6)["data"]), np.uint8
        )
    )
    assert "low" in page.ask("highlight", expr="a", low=1.0, high=0.5)["error"]
    assert "nothing" in page.ask("highlight", expr="nothing", low=0.0, high=0.5)["error"]


def test_a_scene_is_loaded_but_not_its_volume(explorer, volume, tmp_path):
    page, other = Page(explorer), Page(explorer)
    scene = vm.Scene(
        {"volume": {"path": "/etc/passwd"}, "medium": CORE, "camera": CAMERA.replace(incl=5)}
    )
    assert "error" not in page.ask("load", text=scene.dumps())
    for each in (page, other):
        frame, payload = each.wait(
            lambda m: m["kind"] == "frame" and m["exact"] and m["camera"].get("incl") == 5
        )
    image = vm.render(volume, CORE, CAMERA.replace(incl=5, resolution=(48, 40)))
    np.testing.assert_allclose(
        frames.from_float16(frame, payload), image.intensity, atol=2e-3 * image.intensity.max()
    )
    assert explorer.document.settings["volume"] == {"path": "volume.npz"}
    for text in ("medium = 3", "[[medium]", '[[medium]]\ntype = "gold"', "", "[volume]"):
        assert "error" in page.ask("load", text=text)
    background = '[[medium]]\ntype="coefficients"\nemissivity="a"\nextinction="a"\n'
    background += '[render]\nbackground = "/etc/passwd"'
    assert "background" in page.ask("load", text=background)["error"]
    assert explorer.medium == CORE
    page.put("undo")
    page.wait(lambda m: m["kind"] == "document" and len(m["document"]["medium"]) == 2)


VIEWS = [{"type": "orthographic", "incl": i, "phi": 0, "width": 2.5} for i in (0, 30, 70)]


@pytest.mark.parametrize(
    ("path", "what"),
    [
        ({"kind": "orbit", "turns": 0.5}, "gif"),
        ({"kind": "zoom", "factor": 4}, "png"),
        ({"kind": "keyframes", "cameras": VIEWS, "ease": "linear"}, "png"),
    ],
)
def test_a_film_is_made_and_sent(explorer, path, what):
    page = Page(explorer)
    reply = page.ask("film", path=path, frames=5, width=24, what=what)
    data = io.BytesIO(base64.b64decode(reply["data"]))
    if what == "gif":
        film = Pillow.open(data)
        assert (film.n_frames, film.size) == (5, (24, 20))
    else:
        bundle = zipfile.ZipFile(data)
        names = [f"film_{k:04d}.png" for k in range(5)]
        assert bundle.namelist() == names
        pictures = [np.asarray(Pillow.open(bundle.open(name))) for name in names]
        assert pictures[0].shape == (20, 24, 3)
        assert not np.array_equal(pictures[0], pictures[-1])
    told = [m["done"] for m, _ in page.messages if m["kind"] == "progress"]
    assert told == [0.2, 0.4, 0.6, 0.8, 1.0]


def test_warnings_are_told_on_the_page_and_not_printed(volume):
    explorer = Explorer(volume, SHELL.replace(center=7.0), CAMERA)
    page = Page(explorer)
    with warnings.catch_warnings(record=True) as printed:
        warnings.simplefilter("always")
        page.exact(0)
        page.ask("highlight", expr="a", low=5, high=6)
        page.ask("thumbnail", name="bone")
        page.wait(lambda m: m["kind"] == "notice")
        told = len([m for m, _ in page.messages if m["kind"] == "notice"])
        page.ask("film", path={"kind": "orbit"}, frames=4, width=24, what="gif")
    assert not printed
    notices = [m for m, _ in page.messages if m["kind"] == "notice"]
    assert (told, len(notices)) == (1, 2)
    assert all(m["level"] == "warning" and "shows nothing" in m["text"] for m in notices)
    explorer.close()


def test_warnings_of_threads_are_kept_apart():
    entered, left = threading.Event(), threading.Event()
    found = []

    def other():
        with caught_warnings() as mine:
            entered.set()
            assert left.wait(60)
            for _ in range(2):
                warnings.warn("of the other thread", stacklevel=1)
            found.extend(mine)

    thread = threading.Thread(target=other)
    with warnings.catch_warnings(record=True) as printed:
        warnings.simplefilter("always")
        before = warnings.showwarning
        with caught_warnings() as outer:
            thread.start()
            assert entered.wait(60)
            with caught_warnings() as inner:
                warnings.warn("first", stacklevel=1)
            warnings.warn("second", stacklevel=1)
        warnings.warn("not collected", stacklevel=1)
        left.set()
        thread.join()
        assert warnings.showwarning is before
    assert (inner, outer) == (["first"], ["second"])
    assert found == ["of the other thread"] * 2
    assert [str(w.message) for w in printed] == ["not collected"]


def test_a_film_over_a_series(volume, tmp_path):
    for k in range(3):
        vm.Volume(GRID, a=VALUES * (1 - 0.1 * k)).save(tmp_path / f"{k}.npz")
    explorer = Explorer(sorted(tmp_path.glob("*.npz")), SHELL, CAMERA)
    page = Page(explorer)
    reply = page.ask("film", path={"kind": "still"}, frames=3, width=24, what="gif", series=True)
    film = Pillow.open(io.BytesIO(base64.b64decode(reply["data"])))
    assert film.n_frames == 3
    explorer.close()


def test_a_film_is_cancelled_and_questions_do_not_wait_for_it(explorer):
    page = Page(explorer)
    page.exact(0)
    path = {"kind": "orbit"}
    page.say("film", id=1000, path=path, frames=9999, width=200, what="png")
    page.wait(lambda m: m["kind"] == "progress" and m["id"] == 1000)
    assert "intensity" in page.ask("probe", x=0.5, y=0.5)
    assert "one film" in page.ask("film", path=path, frames=2, what="gif")["error"]
    page.say("cancel", of=1000)
    reply, _ = page.wait(lambda m: m["kind"] == "reply" and m["id"] == 1000)
    assert reply["error"] == "cancelled"
    for wrong in (
        {"path": path, "frames": 0},
        {"path": {"kind": "spiral"}, "frames": 2},
        {"path": 3, "frames": 2},
        {"path": {"kind": "keyframes", "cameras": VIEWS}, "frames": 2},
        {"path": path, "frames": 2, "what": "avi"},
        {"path": path, "frames": 2, "width": 1_000_000},
    ):
        assert "error" in page.ask("film", **wrong)


def test_a_film_ends_with_its_page(explorer):
    page, other = Page(explorer), Page(explorer)
    page.say("film", id=1, path={"kind": "orbit"}, frames=9999, width=64, what="png")
    page.wait(lambda m: m["kind"] == "progress")
    page.client.close()
    page.wait(lambda m: m["kind"] == "reply" and m["id"] == 1)
    assert "data" in other.ask("film", path={"kind": "still"}, frames=1, width=24, what="gif")


def test_exports_make_the_same_picture(explorer, volume, tmp_path):
    page = Page(explorer)
    page.exact(0)
    text = page.ask("export", what="python", width=96)["text"]
    volume.save(tmp_path / "volume.npz")
    code = text.replace('"volume.npz"', repr(str(tmp_path / "volume.npz"))).replace(
        "'volume.npz'", repr(str(tmp_path / "volume.npz"))
    )
    scope: dict = {}
    exec(code.replace("picture.png", str(tmp_path / "picture.png")), scope)
    assert scope["medium"] == SHELL + CORE
    assert scope["image"].shape == (80, 96, 3)
    fits = page.ask("export", what="fits", width=96)
    (tmp_path / "a.fits").write_bytes(base64.b64decode(fits["data"]))
    np.testing.assert_array_equal(
        vm.Image.load(tmp_path / "a.fits").intensity, scope["image"].intensity
    )
    scene = page.ask("export", what="toml", width=96)["text"]
    (tmp_path / "scene.toml").write_text(scene)
    assert vm.Scene.load(tmp_path / "scene.toml").medium == SHELL + CORE
    assert "'passwd'" in page.ask("export", what="passwd")["error"]


def test_each_page_takes_away_what_it_shows(explorer):
    first, other = Page(explorer), Page(explorer)
    first.put("look", camera={"type": "orthographic", "incl": 12, "phi": 7}, moving=False)
    other.put("look", camera={"type": "orthographic", "incl": 80, "phi": 7}, moving=False)
    for page, incl in ((first, 12), (other, 80)):
        scene = vm.Scene(loads(page.ask("export", what="toml", width=24)["text"]))
        assert scene.camera.incl == incl
        assert f"incl={incl}.0" in page.ask("export", what="python", width=24)["text"]
        png = base64.b64decode(page.ask("export", what="png", width=24)["data"])
        zipped = page.ask("film", path={"kind": "still"}, frames=1, width=24, what="png")["data"]
        with zipfile.ZipFile(io.BytesIO(base64.b64decode(zipped))) as film:
            frame = film.read(film.namelist()[0])
        drawn = vm.render(explorer.volume, explorer.medium, scene.camera).to_rgb()[::-1]
        for data in (png, frame):
            seen = np.asarray(Pillow.open(io.BytesIO(data)).convert("RGB"))
            np.testing.assert_allclose(seen / 255, drawn, atol=0.51 / 255)


def test_pictures_have_marks_and_grounds_and_say_before_what_they_take(explorer):
    page = Page(explorer)

    def made(**dress):
        answer = page.ask("export", what="png", width=96, **dress)
        return np.asarray(Pillow.open(io.BytesIO(base64.b64decode(answer["data"]))))

    plain, white = made(), made(ground="white")
    assert plain[0, 0].tolist() == [0, 0, 0]
    assert white[0, 0].tolist() == [255, 255, 255]
    assert (white >= plain).all()
    alpha = made(ground="transparent")[..., 3]
    assert alpha[0, 0] == 0
    assert alpha.max() > 50
    bar = made(marks=["scale_bar"])
    assert bar.shape == plain.shape
    assert (bar[-12:] != plain[-12:]).any()
    assert made(marks=["color_bar"], ground="white").shape[1] > plain.shape[1]
    assert "'ruler'" in page.ask("export", what="png", marks=["ruler"])["error"]
    assert "'green'" in page.ask("export", what="png", ground="green")["error"]
    path = {"path": {"kind": "orbit"}, "frames": 30, "fps": 24}
    for what, more in (("png", {}), ("fits", {}), ("gif", path)):
        said = page.ask("estimate", what=what, marks=["scale_bar"], ground="white", **more)
        assert min(said["seconds"], said["bytes"], said["start"] + 1e-9) > 0
    # Three channels of float32, the transparency and the optical depth, for each pixel.
    assert page.ask("estimate", what="fits")["bytes"] == pytest.approx(24, rel=0.3)


def test_a_follower_sees_what_the_leader_does_and_changes_nothing(explorer):
    leader, follower = Page(explorer), Page(explorer, leader=False)
    leader.put("look", camera={"type": "orthographic", "incl": 12, "phi": 7}, moving=False)
    follower.wait(lambda m: m["kind"] == "frame" and m["exact"] and m["camera"]["incl"] == 12)
    before = json.dumps(explorer.document.settings)
    follower.put("look", camera={"type": "orthographic", "incl": 80, "phi": 7}, moving=False)
    for kind, rest in (
        ("set", {"patch": [["medium", []]], "label": "remove"}),
        ("undo", {}),
        ("time", {"index": 0}),
    ):
        number = follower.put(kind, **rest)
        # The page takes back what it changed.
        follower.wait(lambda m, n=number: m["kind"] == "notice" and m["n"] == n)
        follower.wait(lambda m, n=number: m["kind"] == "document" and m["n"] == n)
    assert "follows" in follower.ask("suggest", name=None)["error"]
    assert "follows" in follower.ask("film", path={"kind": "orbit"}, frames=2)["error"]
    assert json.dumps(explorer.document.settings) == before


def test_a_series_in_time(volume, tmp_path):
    for k in range(3):
        vm.Volume(GRID, a=VALUES * (1 - 0.1 * k)).save(tmp_path / f"{k}.npz")
    explorer = Explorer(sorted(tmp_path.glob("*.npz")), SHELL, CAMERA)
    assert explorer.describe()["name"] == "0.npz"
    page = Page(explorer)
    last = page.put("time", index=2)
    page.wait(lambda m: m["kind"] == "frame" and m["exact"] and m["revision"] >= 1)
    assert explorer.document.settings["volume"]["path"].endswith("2.npz")
    told, _ = page.wait(lambda m: m["kind"] == "volume")
    assert told["volume"]["name"] == "2.npz"
    assert told["volume"]["fields"][0]["max"] == pytest.approx(0.8 * VALUES.max())
    page.put("time", index=7)
    page.wait(lambda m: m["kind"] == "notice" and "no file 7" in m["text"])
    explorer.close()
    assert last


DEEP: list = []
for _ in range(900):
    DEEP = [DEEP]


@pytest.mark.parametrize(
    "message",
    [
        None,
        3,
        [],
        {},
        {"kind": "format"},
        {"kind": "look"},
        {"kind": "look", "n": 1, "camera": {"type": "nothing"}},
        {"kind": "look", "n": 1, "camera": {}, "extra": 1},
        {"kind": "look", "n": "x", "camera": {}},
        {"kind": "set", "n": 1, "patch": 3},
        {"kind": "set", "n": 1, "patch": [["volume.path", "/etc/passwd"]]},
        {"kind": "size", "n": 1, "size": [0]},
        {"kind": "seen", "frame": None},
        {"kind": "hello", "protocol": 99},
        {"kind": "_open_numbers"},
        {"kind": "_refuse"},
        {"kind": "x" * 100_000},
        {"kind": "look", "n": 1e400, "camera": {}},
        {"kind": "look", "n": 1, "camera": {"type": "orthographic", "incl": 10**400}},
        {"kind": "look", "n": 1, "camera": 3},
        {"kind": "look", "n": 1, "camera": {"type": "perspective", "position": [1e308] * 3}},
        {"kind": "size", "n": 1, "size": [10**400, 5]},
        {"kind": "size", "n": 1, "size": [5, 5], "scale": float("nan")},
        {"kind": "set", "n": 1, "patch": [["bookmarks", [float("inf")]]]},
        {"kind": "set", "n": 1, "patch": [["medium.0.opacity", 10**400]]},
        {"kind": "set", "n": 1, "patch": [["medium.0.opacity", {}]]},
        {"kind": "set", "n": 1, "patch": [["medium", None]]},
        {"kind": "set", "n": 1, "patch": [["camera", None]]},
        {"kind": "set", "n": 1, "patch": [["camera", 3]]},
        {"kind": "set", "n": 1, "patch": [["image", [1]]]},
        {"kind": "set", "n": 1, "patch": [["render", 3]]},
        {"kind": "set", "n": 1, "patch": [["bookmarks", DEEP]]},
        {"kind": "undo", "n": None},
        {"kind": "redo"},
        {"kind": "seen", "frame": 1e400},
        {"kind": "time", "n": 1, "index": 1e400},
        {"kind": "time", "n": 1, "index": None},
        {"kind": "cancel", "of": []},
        {"kind": "probe", "id": float("nan"), "x": 0.5, "y": 0.5},
        {"kind": "hello", "protocol": 1, "size": [1e400, 5]},
        {"kind": "hello", "protocol": 1, "size": None},
    ],
    ids=lambda message: repr(message)[:60],
)
def test_wrong_messages_are_answered_and_nothing_breaks(explorer, message):
    page = Page(explorer)
    before = json.dumps(explorer.document.settings)
    page.client.receive(message)
    notice, _ = page.wait(lambda m: m["kind"] == "notice" and m["level"] == "error")
    assert len(notice["text"]) < 1000
    assert json.dumps(explorer.document.settings) == before
    assert explorer.medium == SHELL + CORE
    assert "intensity" in page.ask("probe", x=0.5, y=0.5)


@pytest.mark.parametrize(
    "question",
    [
        {"kind": "probe", "x": 10**400, "y": 0.5},
        {"kind": "histogram", "expr": "a", "bins": 10**400},
        {"kind": "slice", "expr": "a", "axis": 10**400, "at": 0.5},
        {"kind": "highlight", "expr": "a", "low": -(10**400), "high": 1},
        {"kind": "export", "what": "png", "width": 10**400},
        {"kind": "film", "path": 3, "frames": 2},
        {"kind": "load", "text": 3},
        {"kind": "thumbnail", "name": []},
    ],
)
def test_strange_questions_are_answered_with_an_error(explorer, question):
    assert Page(explorer).ask(**question)["error"]


def test_pages_are_answered_in_turn(explorer, monkeypatch):
    from voluminous.viewer.questions import QUESTIONS

    answered, begun, go_on = [], threading.Event(), threading.Event()

    def slowly(page, message, progress):
        begun.set()
        assert go_on.wait(60)
        answered.append(page)
        return {}

    monkeypatch.setitem(QUESTIONS, "slice", (slowly, QUESTIONS["slice"][1]))
    busy, other = Page(explorer), Page(explorer)
    for k in range(20):
        busy.say("slice", id=k)
    assert begun.wait(60)
    for k in range(2):
        other.say("slice", id=k)
    go_on.set()
    busy.wait(lambda m: m["kind"] == "reply" and m["id"] == 19)
    assert answered[:4] == [busy.client, other.client] * 2
    assert [m["id"] for m, _ in busy.messages if m["kind"] == "reply"] == list(range(20))


def test_a_field_that_does_not_exist_is_refused_before_anything_is_drawn(explorer):
    page = Page(explorer)
    last = page.put("set", patch=[["medium.0.expr", "nothing_here"]], label="expression")
    notice, _ = page.wait(lambda m: m["kind"] == "notice" and "nothing_here" in m["text"])
    assert notice["n"] == last
    assert explorer.medium == SHELL + CORE


def test_an_error_of_the_renderer_is_told_and_the_next_picture_comes(explorer):
    page = Page(explorer)
    page.put("set", patch=[["render.bounds", True], ["render.scheme", "second-order"]], label="a")
    notice, _ = page.wait(lambda m: m["kind"] == "notice" and "bounds" in m["text"])
    assert "n" not in notice  # the change itself was taken
    last = page.put("undo")
    page.exact(last)


def test_python_of_a_scene_makes_its_volume():
    shell = {"type": "gaussian", "expr": "twice", "center": 2.0, "sigma": 0.5, "color": 1.0}
    scene = vm.Scene(
        {
            "volume": {"model": "sphere", "resolution": 8, "derived": {"twice": "2 * inside"}},
            "medium": [{**shell, "opacity": 0.3, "path_length": 0.1}],
            "camera": {"resolution": 8},
        }
    )
    code = python_of(scene).partition("image.save")[0]
    scope: dict = {}
    exec(code, scope)
    np.testing.assert_array_equal(scope["image"].intensity, scene.render().intensity)


def test_the_copied_code_is_short_and_draws_the_same_picture(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    core = vm.models.prestellar_core(16)
    core.save("volume.npz")
    by = vm.ColorBy("log10(density)", cmap="inferno", vmin=3.123456789, vmax=5)
    medium = vm.suggest_medium(core) + vm.presets.skin_and_bone(core)
    medium += vm.Gaussian("log10(density)", 4.2123456789, 0.0123456789, by, 0.3, 2.512345678e16)
    medium += vm.Coefficients(["0 * density" + " + 0 * density" * 12] * 3, "0 / (1.23456789 pc)")
    # A thousandth of the volume, off its centre: six digits of that would not do.
    camera = vm.Orthographic(
        60.123456789, 30, width=5.123456789e14, center=(1.23456789e17, -2e16, 0.0), resolution=48
    )
    scene = vm.Scene({"volume": {"path": IN_MEMORY}, "medium": medium, "camera": camera})
    code = python_of(scene)
    assert max(map(len, code.splitlines())) <= 88
    assert "width='34.2482 au'" in code
    numbers = re.findall(r"[=\[' ]-?(\d+\.\d+)", code)
    assert sum(len(n.replace(".", "").lstrip("0")) > 6 for n in numbers) <= 3  # the centre's
    scope: dict = {}
    exec(code, scope)
    wanted = scene.render().intensity
    assert wanted.std() > 0.01 * wanted.max()  # not flat
    # What is drawn is exact to 1e-3 of the brightest pixel; the code, to less than that.
    np.testing.assert_allclose(scope["image"].intensity, wanted, atol=1e-3 * wanted.max())
    again = vm.Scene(loads(shortened(scene).dumps()), volume=core)
    assert repr(again.medium) == repr(scope["medium"])
    views = [camera.describe(), camera.replace(phi=40).describe()]
    code = keyframes_of(scene, views, 21)
    exec(f"import voluminous as vm\n{code}", scope)
    assert max(map(len, code.splitlines())) <= 88
    assert [len(scope["cameras"]), scope["cameras"][10].phi] == [21, pytest.approx(35)]


# --- large volumes, of which a sample is at hand -------------------------------------------------


def test_a_sample_is_every_kth_cell_between_the_same_walls(tmp_path):
    """Read in slabs, or taken from an array; of an odd number of cells, too."""
    rng = np.random.default_rng(1)
    values = rng.integers(0, 5, (35, 33, 30))  # labels stay labels
    np.save(tmp_path / "a.npy", values.astype(np.uint8))
    unread = vm.io.registry.open_lazily(tmp_path / "a.npy")
    read = vm.open(tmp_path / "a.npy")
    for step, first in ((2, (0, 0, 0)), (3, (1, 1, 1)), (4, (1, 0, 1))):
        most = np.prod([-(-n // step) for n in values.shape])
        samples = [sampled(volume, int(most)) for volume in (unread, read)]
        assert all(sample.meta["every"] == step for sample in samples)
        wanted = values[tuple(slice(k, None, step) for k in first)]
        for sample in samples:
            np.testing.assert_array_equal(sample.array("a"), wanted)
            np.testing.assert_array_equal(sample.grid.bounds, read.grid.bounds)
    assert unread.waiting == ("a",)
    assert sampled(read, values.size) is read
    assert sampled(read, 9000) is sampled(read, 9000)


def few_at_hand(monkeypatch):
    """Let at most 16³ cells be at hand."""
    for room in ("explorer", "painter", "questions", "slices"):
        monkeypatch.setattr(f"voluminous.viewer.{room}.at_hand", partial(at_hand, most=16**3))


@pytest.fixture
def sampling(tmp_path, monkeypatch):
    """Return a file of 32³ cells of which 16³ are at hand."""
    few_at_hand(monkeypatch)
    axis = (np.arange(32) - 15) / 16  # the highest is in no sample
    values = np.exp(-sum(np.meshgrid(axis**2, axis**2, axis**2, indexing="ij")))
    np.save(tmp_path / "a.npy", values.astype(np.float32))
    return tmp_path / "a.npy"


def test_a_large_volume_turns_at_once_and_is_drawn_whole_at_rest(sampling):
    """Every 2nd cell; all, without error control; all, to the tolerance."""
    volume = vm.io.registry.open_lazily(sampling)
    explorer = Explorer(volume, SHELL, CAMERA)
    page = Page(explorer)
    exact, payload = page.exact(0)
    known, _ = page.wait(lambda m: m["kind"] == "volume")
    images = [(m, data) for m, data in page.messages if m["kind"] == "frame" and m["scale"] == 1]
    stages = [(m["every"], m["done"], m["exact"], m["codec"]) for m, _ in images]
    assert stages[:2] == [(2, 0.0, False, "float16"), (1, 0.0, False, "float16")]
    assert stages[-1] == (1, 1.0, True, "float16")
    welcome, _ = page.wait(lambda m: m["kind"] == "welcome")
    array = volume.array("a")
    assert welcome["volume"]["fields"][0]["max"] < known["volume"]["fields"][0]["max"]
    assert known["volume"]["fields"][0]["max"] == pytest.approx(array.max())
    # Each is the picture that Python draws, in the end the one of the default tolerance.
    camera, sample = CAMERA.replace(resolution=(48, 40)), sampled(volume, 16**3)
    wanted = [
        vm.render(sample, SHELL, camera, tolerance=None),
        vm.render(volume, SHELL, camera, tolerance=None),
        vm.render(volume, SHELL, camera),
    ]
    for (head, data), image in zip([*images[:2], (exact, payload)], wanted, strict=True):
        top = image.intensity.max()
        picture = frames.from_float16(head, data)
        # A sample is crossed in steps of one cell, which its own picture need not be.
        np.testing.assert_allclose(picture, image.intensity, atol=2e-3 * top, rtol=2.0**-11)
    assert exact["error"] <= 1e-3
    # From now on all cells are quick to draw.
    page.exact(page.put("look", camera={**exact["camera"], "phi": 40.0}, moving=False))
    assert page.messages[-1][0]["every"] == 1
    assert all(m["every"] == 1 for m, _ in page.messages if m.get("camera", {}).get("phi") == 40.0)
    explorer.close()


def test_a_sample_is_shown_of_what_cannot_be_drawn_chunk_by_chunk(sampling, monkeypatch):
    monkeypatch.setattr("voluminous.viewer.explorer.is_drawn_in_blocks", lambda _: True)
    explorer = Explorer(vm.io.registry.open_lazily(sampling), SHELL.replace(shading=0.5), CAMERA)
    page = Page(explorer)
    frame, _ = page.exact(0)
    assert (frame["every"], frame["error"]) == (2, None)
    notice, _ = page.wait(lambda m: m["kind"] == "notice")
    assert notice["text"].startswith("one of 2³ cells is shown: 'grad(a).x' is computed")
    explorer.close()


def test_previews_do_not_wait_for_a_full_picture(explorer, monkeypatch):
    """Which reads, and measures, for seconds in calls that nothing interrupts."""
    held, free = threading.Event(), threading.Event()
    level = explorer.painter.draw_level

    def slow(*args):
        held.set()
        assert free.wait(60)
        return level(*args)

    monkeypatch.setattr(explorer.painter, "draw_level", slow)
    page = Page(explorer)
    assert held.wait(60)
    camera = {**explorer.document.settings["camera"], "phi": 77.0}
    last = page.put("look", camera=camera, moving=True)
    frame, _ = page.wait(lambda m: m["kind"] == "frame" and m["n"] == last)
    assert not frame["exact"]
    free.set()
    last = page.put("look", camera=camera, moving=False)
    assert page.exact(last)[0]["camera"]["phi"] == 77.0


# --- files that are larger than memory, of which there are coarser levels -------------------------


@pytest.fixture
def large(tmp_path, monkeypatch):
    """Return 64³ cells that may not be in memory, of which levels 1 and 2 are 32³ and 16³."""
    grid = vm.CartesianGrid.uniform(64, (-1, 1))
    volume = vm.Volume(grid)
    volume["a"] = "exp(-(x**2 + y**2 + z**2)) + 0.02 * sin(60 * x)"
    volume.save(tmp_path / "large.zarr", levels=True, stats=True, chunks=16)
    # As if 16³ cells were the most that memory holds.
    samples = "voluminous.calibration.samples"
    monkeypatch.setattr(f"{samples}.level_within", lambda v, _: level_within(v, 16**3))
    few_at_hand(monkeypatch)
    return vm.io.registry.open_lazily(tmp_path / "large.zarr")


@pytest.fixture
def reads(monkeypatch):
    """Return the list of the levels and numbers of cells that are read."""
    boxes, read = [], FieldStore.read

    def counted(self, name, low, high, level=0):
        values = read(self, name, low, high, level)
        if self.shape(0) == (64, 64, 64):
            boxes.append((level, values.size))
        return values

    monkeypatch.setattr(FieldStore, "read", counted)
    return boxes


def test_a_large_file_is_shown_from_coarse_levels_to_the_one_that_suffices(large, reads):
    explorer = Explorer(large, SHELL, CAMERA)
    page = Page(explorer)
    welcome, _ = page.wait(lambda m: m["kind"] == "welcome")
    told = welcome["volume"]
    assert told["cells"] == 64**3
    # Ranges are those of all cells.
    lowest, highest = (getattr(large.store.extremes("a"), f)() for f in ("min", "max"))
    assert (told["fields"][0]["min"], told["fields"][0]["max"]) == (lowest, highest)
    frame, payload = page.exact(0)
    # Pixels are 2.5 / 48 wide, cells 1/32, 1/16 and 1/8: all cells are needed.
    levels = [m["level"] for m, _ in page.messages if m["kind"] == "frame" and m["scale"] == 1]
    assert levels == sorted(levels, reverse=True)
    assert {0, 1, 2} == set(levels)
    assert (frame["level"], frame["done"]) == (0, 1.0)
    assert frame["error"] <= 1e-3
    done = [m["done"] for m, _ in page.messages if m["kind"] == "frame"]
    assert done == sorted(done)
    image = vm.render(
        large, SHELL, CAMERA.replace(resolution=(48, 40)), level="auto", memory="1 GiB"
    )
    picture = frames.from_float16(frame, payload)
    top = image.intensity.max()
    np.testing.assert_allclose(picture, image.intensity, atol=2.0**-11 * top, rtol=2.0**-11)
    # A click shows what its ray sees in all cells.
    reply = page.ask("probe", x=0.4, y=0.55)
    ray = vm.probe(
        large.level(0),
        SHELL,
        CAMERA.replace(resolution=(48, 40)),
        (19, 22),
        tolerance=None,
        memory="1 GiB",
    )
    np.testing.assert_array_equal(reply["fields"]["a"], ray.points.fields["a"])
    assert len(ray.begin) > 64
    # From farther away level 1 suffices: no other cells are read.
    del reads[:]
    camera = {**explorer.document.settings["camera"], "width": 3.5}
    frame, _ = page.exact(page.put("look", camera=camera))
    assert frame["level"] == 1
    assert frame["error"] is None  # that of the level is unknown
    assert reads
    assert {level for level, _ in reads} == {1}
    assert large.waiting == ("a",)
    explorer.close()


def test_quick_answers_about_a_large_file_are_those_of_a_level(large, reads):
    explorer = Explorer(large)
    page = Page(explorer)
    coarse = large.level(2)
    assert repr(explorer.medium) == repr(vm.suggest_medium(coarse))
    reply = page.ask("histogram", expr="a", bins=8)
    assert reply["counts"] == np.histogram(coarse.array("a"), 8)[0].tolist()
    assert reply["level"] == 2
    # A plane is read from the file, and nothing else.
    cut = page.ask("slice", expr="a", axis=0, at=0.5, size=[64, 64])
    assert (cut["level"], cut["width"]) == (0, 64)
    for question in (
        {"kind": "thumbnail", "name": "bone"},
        {"kind": "highlight", "expr": "a", "low": 0.5, "high": 0.6},
        {"kind": "suggest", "name": None},
    ):
        assert "error" not in page.ask(**question)
    # The level was read once, and once by this test.
    assert [size for level, size in reads if level == 2] == [16**3] * 2
    assert max(size for _, size in reads) < 64**3
    assert large.waiting == ("a",)
    explorer.close()


def test_what_cannot_be_drawn_in_pieces_is_shown_from_a_level_in_memory(large):
    explorer = Explorer(large, SHELL, CAMERA, {"render": {"scheme": "second-order"}})
    page = Page(explorer)
    frame, _ = page.exact(0)
    assert frame["level"] == 2
    notice, _ = page.wait(lambda m: m["kind"] == "notice")
    assert notice["text"].startswith("level 2 of the file is shown: ")
    assert "second-order" in notice["text"]
    assert large.waiting == ("a",)
    explorer.close()


def test_a_picture_in_pieces_is_given_up_for_a_newer_one(large, monkeypatch):
    explorer = Explorer(large, SHELL, CAMERA)
    page = Page(explorer)
    page.wait(lambda m: m["kind"] == "frame" and m["level"] == 1)
    last = 0
    for angle in (31, 32, 33):
        camera = {**explorer.document.settings["camera"], "phi": angle}
        last = page.put("look", camera=camera)
    frame, _ = page.exact(last)
    assert frame["camera"]["phi"] == 33
    shown = [m for m, _ in page.messages if m["kind"] == "frame" and m["exact"]]
    assert [m["n"] for m in shown] == [last]
    explorer.close()
