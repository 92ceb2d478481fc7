"""The explorer in a real browser: what it shows equals the picture, by any way, after any fault."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import socket
import time
import zlib

import numpy as np
import pytest

import chromium
import voluminous as vm

pytest.importorskip("playwright.sync_api")
if chromium.PATH is None:
    pytest.skip("there is no chromium", allow_module_level=True)

VOLUME = vm.models.prestellar_core(32)
MEDIUM = vm.suggest_medium(VOLUME).calibrated(VOLUME)
CAMERA = vm.Orthographic.framing(VOLUME, MEDIUM, 60, 30).replace(width=3e17)
SECONDS = 60.0
REST = "[data-exact=true]"


@pytest.fixture(scope="module")
def browser():
    with chromium.launched() as browser:
        yield browser


class Tab:
    """A page with an explorer of its own."""

    def __init__(self, browser, volume=VOLUME, medium=MEDIUM, camera=CAMERA, **context):
        self.view = vm.view(volume, medium, camera, notebook=False, browser=False)
        self.context = browser.new_context(viewport={"width": 800, "height": 500}, **context)
        self.page = self.context.new_page()
        self.page.set_default_timeout(1000 * SECONDS)
        self.errors, self.urls = [], []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda m: m.type == "error" and self.errors.append(m.text))
        self.page.on("request", lambda request: self.urls.append(request.url))
        self.page.goto(self.view.url)
        self.rest()

    def close(self):
        self.context.close()
        self.view.close()

    @property
    def explorer(self):
        return self.view._explorer

    @property
    def session(self):
        return self.explorer._clients[-1].session

    def rest(self):
        """Wait until the exact picture of the last input is there."""
        self.page.wait_for_selector(REST, state="attached")
        end = time.monotonic() + SECONDS
        while not (self.session.is_exact and self.session.shown >= self.session.wanted):
            assert time.monotonic() < end
            self.page.wait_for_timeout(20)
        self.page.wait_for_selector(REST, state="attached")
        self.page.wait_for_timeout(400)  # one picture fades into the next

    def press(self, *keys):
        """Press keys that move the camera, and wait until the server knows."""
        self.page.locator("canvas").first.focus()
        for key in keys:
            before, end = self.session.wanted, time.monotonic() + SECONDS
            self.page.keyboard.press(key)
            while self.session.wanted == before:
                assert time.monotonic() < end
                self.page.wait_for_timeout(10)

    def pixels(self):
        """Return what the canvas shows, without what is drawn over it."""
        self.page.add_style_tag(
            content=".vlm-stage > *:not(canvas), .vlm-stage *:not(canvas) { opacity: 0 !important }"
        )
        canvas = self.page.locator("canvas").first
        from PIL import Image

        picture = Image.open(io.BytesIO(canvas.screenshot()))
        return np.asarray(picture.convert("RGB"))[::-1] / 255.0

    def image(self):
        """Return what Python draws of what is on the screen."""
        return self.view.image(resolution=self.session.size)

    def shows(self, image, within, part=1.0, **options):
        shown, wanted = self.pixels(), image.to_rgb(**options)
        assert wanted.std() > 0.05  # not flat
        h, w = (min(a, b) for a, b in zip(shown.shape[:2], wanted.shape[:2], strict=True))
        if folder := os.environ.get("VOLUMINOUS_SCREENSHOTS"):
            from PIL import Image

            both = np.concatenate([shown[-h:, :w], wanted[-h:, :w]], axis=1)[::-1]
            Image.fromarray((255 * both).astype(np.uint8)).save(f"{folder}/compare.png")
        wrong = np.abs(shown[-h:, :w] - wanted[-h:, :w])[2:-2, 2:-2]  # the focus has a frame
        assert np.quantile(wrong, part) * 255 <= within


@pytest.fixture
def tab(browser):
    tab = Tab(browser, bypass_csp=True)
    yield tab
    tab.close()


def test_the_page_shows_the_picture_and_breaks_no_rule(browser):
    tab = Tab(browser)
    assert tab.errors == []
    own = tab.view.url.partition("#")[0]
    known = (own, "blob:", "data:", own.replace("http", "ws"))
    assert all(url.startswith(known) for url in tab.urls)
    assert "token" not in tab.page.url
    if folder := os.environ.get("VOLUMINOUS_SCREENSHOTS"):
        tab.page.screenshot(path=f"{folder}/explorer.png")
    tab.close()


def test_exact_is_only_what_shows_the_newest_document(tab, monkeypatch):
    """Nothing is painted for a while: the old picture stays, and its badge does not say exact."""
    badge, root = tab.page.locator(".vlm-badge"), tab.page.locator(".vlm")
    client = tab.explorer._clients[-1]

    def states():
        tab.page.wait_for_timeout(300)
        return badge.get_attribute("data-state"), root.get_attribute("data-exact")

    assert badge.inner_text().startswith("exact, error ≤ 0.")
    with monkeypatch.context() as held:
        held.setattr(tab.explorer.painter, "pages", list)
        client.change([("image.exposure", 2.0)], "exposure")  # which is the page's
        assert states() == ("exact", "true")
        client.change([("medium.0.opacity", 0.77)], "opacity")  # of another page
        assert states() == ("preview", "false")
        assert badge.inner_text() == "drawing …"
    tab.rest()
    assert states() == ("exact", "true")
    with monkeypatch.context() as held:
        held.setattr(tab.explorer.painter, "pages", list)
        tab.press("ArrowLeft")
        assert states() == ("preview", "false")
    tab.rest()
    # The title is that of the file that is shown.
    told = {**tab.explorer.describe(), "name": "step_2.npz"}
    client.send({"kind": "volume", "volume": told})
    tab.page.wait_for_timeout(100)
    assert tab.page.locator("h1").inner_text() == "step_2.npz"
    # A sample of a large volume is named as such.
    frame = {"scale": 0.5, "done": 0.0, "every": 2, "exact": False}
    sent = []
    monkeypatch.setattr(client, "send", lambda m, p=b"", go=client.send: go(m | frame, p))
    monkeypatch.setattr(type(client), "drew", lambda *_: sent.append(1))
    tab.press("ArrowLeft")
    tab.page.wait_for_timeout(1000)
    assert badge.inner_text() == "½ preview of every 2nd cell"


def test_pixels_at_rest_are_those_of_python(tab):
    tab.shows(tab.image(), 2.0)


def drag(tab, dx, dy, steps=10):
    box = tab.page.locator("canvas").first.bounding_box()
    x, y = box["x"] + 0.4 * box["width"], box["y"] + 0.5 * box["height"]
    tab.page.mouse.move(x, y)
    tab.page.mouse.down()
    for k in range(1, steps + 1):
        tab.page.mouse.move(x + dx * k / steps, y + dy * k / steps)
        tab.page.wait_for_timeout(16)
    return x + dx, y + dy


def test_a_drag_shows_previews_and_ends_exact(tab):
    before = tab.view.camera
    drag(tab, 60, 25)
    end = time.monotonic() + SECONDS
    while tab.session.shown < tab.session.wanted and time.monotonic() < end:
        tab.page.wait_for_timeout(20)
    tab.page.wait_for_timeout(300)
    assert tab.page.locator(REST).count() == 0
    now = tab.view.camera
    assert (now.incl, now.phi) != (before.incl, before.phi)
    # Eight bits of the logarithm, enlarged from a part of the pixels: nearly all of them near.
    exposure = next(iter(tab.explorer.painter._exposures.values()))
    tab.shows(tab.image(), 8.0, 0.9, exposure=exposure)
    tab.page.mouse.up()
    tab.rest()
    tab.shows(tab.image(), 2.0)


def test_zoom_and_keys(tab):
    tab.press("+", "ArrowRight")
    tab.rest()
    tab.shows(tab.image(), 2.0)
    tab.press("z")
    tab.rest()
    assert tab.view.camera.incl == pytest.approx(0, abs=1e-6)
    tab.shows(tab.image(), 2.0)


def test_exposure_costs_no_frame(tab):
    frames = tab.explorer.painter._frame
    exposure = tab.image().exposure
    tab.page.locator("canvas").first.focus()
    tab.page.keyboard.press("e")
    tab.page.keyboard.press("e")
    end = time.monotonic() + SECONDS
    while "exposure" not in tab.explorer.document.settings["image"] and time.monotonic() < end:
        tab.page.wait_for_timeout(20)
    tab.page.wait_for_timeout(500)
    given = tab.explorer.document.settings["image"]["exposure"]
    assert given == pytest.approx(2 * exposure, rel=1e-3)
    tab.shows(tab.image(), 2.0, exposure=given)
    assert tab.explorer.painter._frame == frames


def test_a_click_asks_the_probe(tab):
    box = tab.page.locator("canvas").first.bounding_box()
    tab.page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    tab.page.get_by_role("tab", name="Ray").click()
    panel = tab.page.get_by_role("tabpanel", name="Ray")
    panel.locator("svg, canvas").first.wait_for()
    nx, ny = tab.session.size
    ray = vm.probe(VOLUME, tab.view.medium, CAMERA.replace(resolution=(nx, ny)), (nx // 2, ny // 2))
    assert f"{float(ray.optical_depth[0]):.2g}"[:3] in panel.inner_text()


def test_a_clip_cuts_the_picture(tab):
    """By a face that is dragged, by sliders and by a key, and undone."""
    page = tab.page
    tab.press("f")  # all of the box
    tab.rest()
    page.get_by_role("tab", name="Clip").click()
    face = page.locator("circle.vlm-face.vlm-x").nth(1)  # x to
    box = face.bounding_box()
    page.mouse.move(x := box["x"] + 7, y := box["y"] + 7)
    page.mouse.down()
    page.mouse.move(x - 60, y + 10, steps=4)
    page.mouse.up()
    page.get_by_role("button", name="Across this view").press("Enter")
    page.get_by_role("slider", name="Depth").press("ArrowLeft")
    page.get_by_role("slider", name="z from").press("PageUp")

    def clip():
        return tab.explorer.document.settings["render"].get("clip")

    def becomes(wanted):
        end = time.monotonic() + SECONDS
        while not wanted(clip()):
            assert time.monotonic() < end, clip()
            page.wait_for_timeout(20)

    becomes(lambda text: text and "halfspace" in text and text.count("-3.85715e+17") == 2)
    region = vm.regions.region_of(clip())
    low, high = (end.tolist() for end in (region.parts[0].low, region.parts[0].high))
    edge = VOLUME.grid.bounds[0, 1]
    assert low[:2] == [-edge, -edge]
    assert -edge < low[2] < 0
    assert 0 < high[0] < edge
    assert high[1:] == [edge, edge]
    normal = CAMERA.lines_of_sight(np.zeros((3, 1)), VOLUME.grid)[:, 0]
    np.testing.assert_allclose(region.parts[1].normal, normal, atol=1e-5)
    text = clip()
    tab.page.locator("canvas").first.focus()
    page.keyboard.press("k")
    becomes(lambda now: now is None)
    page.keyboard.press("k")
    becomes(lambda now: now == text)
    tab.rest()
    assert tab.image().provenance["clip"] == str(region)
    tab.shows(tab.image(), 2.0)


def test_a_cut_connection_comes_back_with_what_was_changed(tab):
    client = tab.explorer._clients[-1]
    tab.page.locator("canvas").first.focus()
    for connection in list(tab.view._server._server.server_state.connections):
        connection.loop.call_soon_threadsafe(connection.transport.abort)
    tab.page.keyboard.press("ArrowRight")
    tab.page.keyboard.press("ArrowRight")
    end = time.monotonic() + SECONDS
    while client in tab.explorer._clients or not tab.explorer._clients:
        assert time.monotonic() < end
        tab.page.wait_for_timeout(20)
    tab.page.wait_for_timeout(300)
    tab.rest()
    assert tab.view.camera.phi != pytest.approx(CAMERA.phi)
    tab.shows(tab.image(), 2.0)


def test_a_lost_graphics_context_is_made_again(tab):
    tab.page.evaluate(
        "() => { const gl = document.querySelector('canvas').getContext('webgl2');"
        " const lose = gl.getExtension('WEBGL_lose_context'); lose.loseContext();"
        " setTimeout(() => lose.restoreContext(), 100); }"
    )
    tab.page.wait_for_timeout(500)
    tab.press("ArrowRight")
    tab.rest()
    tab.shows(tab.image(), 2.0)


def until(tab, true):
    """Wait until something is true."""
    end = time.monotonic() + SECONDS
    while not true():
        assert time.monotonic() < end
        tab.page.wait_for_timeout(20)


def panel(tab, name):
    tab.page.get_by_role("tab", name=name).click()
    return tab.page.get_by_role("tabpanel", name=name)


def undo_list(tab):
    return tab.explorer.document.labels[0]


def test_a_scene_file_is_pasted_or_dropped(tab):
    given = "[camera]\nincl = 10\nphi = 80\nwidth = 2e17\n[[medium]]\ntype = 'isosurface'\n"
    given += "expr = 'log10(density)'\nlevel = 4.0\ncolor = 'orange'\n"
    scene = panel(tab, "Scene")
    scene.get_by_label("Scene file or link").fill(given.replace("density", "dust"))
    scene.get_by_role("button", name="Load").click()
    wrong = scene.get_by_role("alert")
    until(tab, lambda: "dust" in wrong.inner_text())
    assert undo_list(tab) == []
    scene.get_by_label("Scene file or link").fill(given)
    scene.get_by_role("button", name="Load").click()
    until(tab, lambda: tab.page.locator(".vlm-angles").inner_text().startswith("incl 10.0°"))
    assert wrong.inner_text() == ""
    assert len(undo_list(tab)) == 1
    tab.rest()
    assert tab.view.camera.phi == 80
    assert isinstance(tab.view.medium, vm.Isosurface)
    tab.shows(tab.image(), 2.0)
    dropped = given.replace("incl = 10", "incl = 70").encode()
    file = {"name": "scene.toml", "mimeType": "application/toml", "buffer": dropped}
    scene.locator("input[type=file]").set_input_files(file)
    until(tab, lambda: tab.view.camera.incl == 70)


def test_a_link_carries_the_scene_and_no_secret(browser):
    tab = Tab(browser, bypass_csp=True, permissions=["clipboard-read", "clipboard-write"])
    tab.press("ArrowRight")
    tab.page.keyboard.press("e")
    until(tab, lambda: undo_list(tab) == ["exposure"])
    tab.rest()
    tab.page.keyboard.press("l")
    tab.page.get_by_text("Link copied").wait_for()
    link = tab.page.evaluate("navigator.clipboard.readText()")
    head, _, packed = link.partition("#scene=")
    secret = tab.view.url.partition("#token=")[2]
    assert head == tab.view.url.partition("#")[0]
    assert secret not in link
    raw = zlib.decompress(base64.urlsafe_b64decode(packed + "=" * (-len(packed) % 4)))
    assert set(json.loads(raw)) == {
        "medium",
        "camera",
        "render",
        "image",
        "measures",
        "project",
        "slices",
    }
    turned, exposure = tab.view.camera, tab.explorer.document.settings["image"]["exposure"]

    tab.page.keyboard.press("e")
    until(tab, lambda: undo_list(tab) == ["exposure"] * 2)
    for k, address in enumerate((f"{link}&token={secret}", link)):  # the second without leaving
        tab.press("ArrowUp")
        if k == 0:
            tab.page.goto("about:blank")
        tab.page.goto(address)
        until(tab, lambda k=k: undo_list(tab).count("shared scene") == k + 1)
        until(tab, lambda: "#" not in tab.page.url)  # the page is told of it a moment later
        tab.rest()
        assert tab.view.camera == turned
        assert tab.explorer.document.settings["image"]["exposure"] == exposure
        tab.shows(tab.image(), 2.0, exposure=exposure)

    before = tab.explorer.document.revision
    wrong = raw.replace(b"density", b"dust")
    wrong = base64.urlsafe_b64encode(zlib.compress(wrong)).decode().rstrip("=")
    scene = panel(tab, "Scene")
    scene.get_by_label("Scene file or link").fill(f"{head}#scene={wrong}")
    scene.get_by_role("button", name="Load").click()
    scene.get_by_role("alert").get_by_text("dust").wait_for()
    assert tab.page.get_by_text("'dust'").count() == 1  # and not in a corner too
    assert tab.explorer.document.revision == before
    tab.shows(tab.image(), 2.0, exposure=exposure)
    tab.close()


def copied(tab, key):
    tab.page.evaluate("navigator.clipboard.writeText('')")
    tab.page.locator("canvas").first.focus()
    tab.page.keyboard.press(key)
    until(tab, lambda: tab.page.evaluate("navigator.clipboard.readText()"))
    return tab.page.evaluate("navigator.clipboard.readText()")


def scene_of(link):
    packed = link.partition("#scene=")[2].partition("&")[0]
    return json.loads(zlib.decompress(base64.urlsafe_b64decode(packed + "=" * (-len(packed) % 4))))


def test_each_of_two_tabs_takes_away_what_it_shows(browser):
    tab = Tab(browser, bypass_csp=True, permissions=["clipboard-read", "clipboard-write"])
    code = panel(tab, "Scene").get_by_label("Python")
    other = tab.context.new_page()
    other.goto(tab.view.url)
    other.wait_for_selector(REST, state="attached")
    other.locator("canvas").first.focus()
    other.keyboard.press("z")  # incl 0
    until(tab, lambda: tab.explorer.document.settings["camera"]["incl"] == 0)
    tab.page.bring_to_front()
    tab.page.locator("canvas").first.focus()
    tab.page.keyboard.press("ArrowUp")  # incl 65: not the first view, and not drawn yet
    assert scene_of(copied(tab, "l"))["camera"]["incl"] == 65
    assert "incl=65.0" in copied(tab, "c")
    assert "incl = 65.0" in copied(tab, "C")
    until(tab, lambda: "incl=65.0" in code.inner_text())
    other.bring_to_front()
    other.locator("canvas").first.focus()
    other.keyboard.press("s")
    dialog = other.get_by_role("dialog", name="Save")
    dialog.get_by_label("Width").fill("100000")
    dialog.get_by_role("button", name="Save", exact=True).click()
    dialog.get_by_role("alert").get_by_text("8192").wait_for()
    dialog.get_by_label("Width").fill("120")
    dialog.get_by_label("white ground").check()
    dialog.get_by_text("About ").wait_for()
    with other.expect_download() as download:
        dialog.get_by_role("button", name="Save", exact=True).click()
    from PIL import Image

    seen = np.asarray(Image.open(download.value.path()).convert("RGB")) / 255
    ny, nx, _ = seen.shape
    drawn = vm.render(VOLUME, MEDIUM, CAMERA.replace(incl=0, phi=0, resolution=(nx, ny)))
    np.testing.assert_allclose(seen, drawn.to_rgb(background="white")[::-1], atol=0.51 / 255)
    assert tab.errors == []
    tab.close()


@contextlib.contextmanager
def served(port, monkeypatch, folder):
    """Serve the scene at a port, in the session of a user that has this folder."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    view = vm.view(VOLUME, MEDIUM, CAMERA, notebook=False, browser=False, port=port)
    yield view
    view.close()


def test_a_page_says_that_it_is_cut_off_and_goes_on_with_what_was_edited(
    browser, tmp_path, monkeypatch
):
    with contextlib.closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    page = browser.new_page(viewport={"width": 800, "height": 500})
    page.set_default_timeout(1000 * SECONDS)
    field = page.get_by_label("Paste the address")

    def goes_on(view):
        settings, end = view._explorer.document.settings, time.monotonic() + SECONDS
        while not settings["image"].get("exposure") or view.camera.phi == CAMERA.phi:
            assert time.monotonic() < end
            page.wait_for_timeout(50)
            settings = view._explorer.document.settings
        assert field.is_hidden()
        return settings

    sessions = [tmp_path / "first", tmp_path / "second"]
    for folder in sessions:
        folder.mkdir()
    with served(port, monkeypatch, sessions[0]) as view:
        page.goto(f"{view.url[:-5]}wrong")
        page.get_by_text("does not take this page's token").wait_for()
        field.fill("what was it")
        field.press("Enter")
        page.get_by_text("neither an address").wait_for()
        field.fill(view.url.partition("#token=")[2])
        field.press("Enter")
        page.wait_for_selector(REST, state="attached")
        page.locator("canvas").first.focus()
        for key in ("e", "ArrowRight", "Shift+3"):
            page.keyboard.press(key)
        goes_on(view)
    page.get_by_text("The server does not answer. Trying again").wait_for(timeout=5000)
    page.keyboard.press("e")
    with served(port, monkeypatch, sessions[0]) as view:  # with the same token
        settings = goes_on(view)
        assert settings["bookmarks"][0]["key"] == 3
        page.wait_for_selector(REST, state="attached")
    page.get_by_text("is at another address now").wait_for()
    with served(port, monkeypatch, sessions[1]) as view:  # with another one
        page.get_by_text("does not take this page's token").wait_for()
        assert view._explorer.pages == 0
        field.fill(view.url)
        field.press("Enter")
        goes_on(view)
    with served(0, monkeypatch, sessions[1]) as view:  # at another address
        page.get_by_text("is at another address now").wait_for()
        field.fill(view.url)
        field.press("Enter")
        page.wait_for_selector(REST, state="attached")
        goes_on(view)
        assert page.url == view.url.partition("#")[0]
    page.close()


def test_a_film_is_made_and_one_given_up(tab):
    views = panel(tab, "Views")
    for digit, key in ((1, "ArrowRight"), (2, "ArrowUp")):
        tab.press(key)
        tab.page.keyboard.press(f"Shift+{digit}")
    until(tab, lambda: len(tab.explorer.document.settings["bookmarks"]) == 2)
    views.get_by_label("Of", exact=True).select_option("kept views")
    views.get_by_label("File").select_option("GIF")
    for label, value in (("Frames", "4"), ("Width", "64")):
        views.get_by_label(label).fill(value)
        views.get_by_label(label).press("Enter")
    make = views.get_by_role("button", name="Make the film")
    with tab.page.expect_download() as download:
        make.click()
    from PIL import Image

    film = Image.open(download.value.path())
    assert film.n_frames == 4
    assert film.width == 64
    views.get_by_label("Of", exact=True).select_option("orbit")
    views.get_by_label("Frames").fill("500")
    views.get_by_label("Frames").press("Enter")
    make.click()
    bar = views.get_by_role("progressbar", name="progress")
    until(tab, lambda: bar.evaluate("bar => bar.value") > 0)
    views.get_by_role("button", name="Cancel").click()
    tab.page.get_by_text("cancelled").wait_for()
    assert bar.is_hidden()
    assert make.is_enabled()


def test_presets_have_pictures(tab):
    media = panel(tab, "Media")
    media.get_by_text("Presets").click()
    first = media.get_by_role("button", name="suggested")
    pictures = media.locator(".vlm-presets img")
    until(tab, lambda: pictures.first.evaluate("image => image.naturalWidth") == 96)
    assert pictures.count() == 1  # none is made for simulations
    media.get_by_role("button", name="others").click()
    until(tab, lambda: pictures.count() == 1 + len(vm.presets.__all__))
    first.click()
    # It is pressed, and nothing else can be edited, until its picture is there.
    assert first.get_attribute("aria-busy") == "true" or undo_list(tab) == ["suggested media"]
    until(tab, lambda: undo_list(tab) == ["suggested media"])
    until(tab, lambda: not first.is_visible())


def test_labels_are_a_table_and_lengths_have_one_unit(browser):
    grid = vm.CartesianGrid.uniform(16, (0, 160), unit="mm")
    values = np.zeros(grid.shape, np.uint8)
    values[2:8, 4:12, 2:14], values[8:14, 4:12, 2:14] = 1, 9
    volume = vm.Volume(grid, organ=values)
    volume.meta["labels"] = {"organ": [{"number": 1, "name": "lung", "color": [1.0, 0.0, 0.0]}]}
    volume.meta["notes"] = ["resampled"]
    tab = Tab(browser, volume=volume, medium=None, camera=None, bypass_csp=True)
    tab.page.get_by_text("resampled").wait_for()
    labels = panel(tab, "Media").locator(".vlm-labels")
    assert labels.locator("li").count() == 2
    before = tab.pixels()
    labels.get_by_role("button", name="Hide lung").click()
    until(tab, lambda: tab.explorer.document.settings["medium"][0]["visible"] == [False, True])
    tab.rest()
    after = tab.pixels()
    assert (before - after).max() > 0.5
    labels.get_by_label("name of 9").fill("liver")
    labels.get_by_label("name of 9").press("Enter")
    until(tab, lambda: tab.view.medium.labels == ["lung", "liver"])
    # The scale bar, and what a ray says, in the unit of the page.
    bar, unit = tab.page.locator(".vlm-scalebar"), tab.page.get_by_label("Unit of lengths")
    assert unit.input_value() == "mm"
    assert bar.inner_text().endswith(" mm")
    tab.page.locator("canvas").first.click()
    point = tab.page.locator(".vlm-facts-list dd").nth(3)
    until(tab, lambda: point.count() and point.inner_text().endswith(" mm"))
    unit.select_option("cm")
    until(tab, lambda: bar.inner_text().endswith(" cm") and point.inner_text().endswith(" cm"))
    assert tab.errors == []
    tab.close()


def test_values_under_the_pointer_are_shown_in_the_picture(tab):
    histogram = panel(tab, "Media").locator(".vlm-histogram")
    box = histogram.bounding_box()
    tint, root = tab.page.locator(".vlm-highlight"), tab.page.locator(".vlm")
    assert tint.is_hidden()
    tinted = []
    for part in (0.9, 0.3):  # the middle of the core, and its halo
        tab.page.mouse.move(box["x"] + part * box["width"], box["y"] + 0.2 * box["height"])
        tab.page.wait_for_selector("[data-highlight]", state="attached")
        low, high = (float(v) for v in root.get_attribute("data-highlight").split())
        alphas = tint.evaluate(
            "c => { const all = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
            " return [...all].filter((_, i) => i % 4 === 3); }"
        )
        assert low < high
        assert max(alphas) == 255
        tinted.append(np.count_nonzero(alphas))
        tab.page.mouse.move(10, 300)
        tab.page.wait_for_selector(".vlm:not([data-highlight])", state="attached")
        assert tint.is_hidden()
    assert 0 < tinted[0] < 0.5 * tinted[1]


def test_slices_are_linked_with_each_other_and_the_picture(tab):
    page, values = tab.page, VOLUME.array("density")
    panes = page.locator(".vlm-pane")
    page.keyboard.press("q")
    panel(tab, "Slices").get_by_label("Field").select_option("density")
    low, high = VOLUME.grid.bounds.T

    def slices():
        return tab.explorer.document.settings.get("slices", {})

    def cell():
        return tuple(int(k) for k in (np.array(slices()["at"]) - low) / (high - low) * 32)

    def all_read_it():
        read = [panes.nth(k).get_attribute("data-value") for k in range(3)]
        return read == [page.evaluate("String", float(np.float32(values[cell()])))] * 3

    until(tab, lambda: "at" in slices() and all_read_it())
    # In the axial slice a click moves the point along x and y, the wheel along z; in that across y
    # (x to the right, z up) arrow keys by a cell.
    box = panes.nth(0).bounding_box()
    page.mouse.click(box["x"] + 0.45 * box["width"], box["y"] + 0.4 * box["height"])
    until(tab, lambda: cell()[0] < 16 < cell()[1])
    until(tab, all_read_it)
    before = cell()
    page.mouse.wheel(0, -100)
    until(tab, lambda: cell() == (*before[:2], before[2] + 1))
    panes.nth(1).focus()
    page.keyboard.press("ArrowUp")
    until(tab, lambda: cell() == (*before[:2], before[2] + 2))
    until(tab, all_read_it)
    assert page.locator(".vlm-probed").count() == 1  # in the picture
    # The right button: to the right the window grows.
    box = panes.nth(2).bounding_box()
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down(button="right")
    page.mouse.move(x + 100, y, steps=4)
    page.mouse.up(button="right")
    until(tab, lambda: np.ptp(slices().get("window", 0)) > 1.99 * np.ptp(values))
    # A click in the picture moves slices to where half of the light comes from.
    tab.rest()
    old = cell()
    stage = page.locator("canvas").first.bounding_box()
    page.mouse.click(stage["x"] + 0.5 * stage["width"], stage["y"] + 0.6 * stage["height"])
    until(tab, lambda: cell() != old)
    until(tab, all_read_it)
    page.get_by_role("button", name="Maximum").click()
    until(tab, lambda: tab.explorer.document.settings["project"].get("how") == "max")
    page.locator("canvas").first.focus()
    page.keyboard.press("q")
    panes.first.wait_for(state="hidden")
    tab.rest()
    tab.shows(tab.image(), 2.0, colormap="gray")
    assert tab.errors == []
