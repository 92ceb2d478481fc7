"""Letters, views by name, and measures in a real browser, by keyboard alone."""

from __future__ import annotations

import time

import numpy as np
import pytest

import chromium
import voluminous as vm
from voluminous.cameras.views import view_angles

pytest.importorskip("playwright.sync_api")
if chromium.PATH is None:
    pytest.skip("there is no chromium", allow_module_level=True)

GRID = vm.CartesianGrid.uniform(24, (-15, 15), unit="mm")
RADIUS = 10.0
SECONDS = 60.0
REST = "[data-exact=true]"


@pytest.fixture(scope="module")
def tab():
    volume = vm.Volume(GRID)
    volume["depth"] = "20 - r / (1 mm)"  # a ball
    volume.meta["orientation"] = "LPS"
    medium = vm.Isosurface("depth", 20 - RADIUS, (1.0, 0.9, 0.8), 0.95, shading=0.5)
    camera = vm.Orthographic(90, 0, width=32, resolution=64)
    view = vm.view(volume, medium, camera, notebook=False, browser=False)
    with chromium.launched() as browser:
        page = browser.new_page(viewport={"width": 800, "height": 600})
        page.set_default_timeout(1000 * SECONDS)
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda m: m.type == "error" and errors.append(m.text))
        page.goto(view.url)
        page.wait_for_selector(REST, state="attached")
        yield view, page, volume
        assert errors == []
    view.close()


def settings(view):
    return view._explorer.document.settings


def until(page, condition):
    end = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < end
        page.wait_for_timeout(30)


def press(view, page, key):
    """Press a key on the picture that turns it, and wait for the picture."""
    before = settings(view)["camera"]
    page.locator(".vlm-canvas").focus()
    page.keyboard.press(key)
    until(page, lambda: settings(view)["camera"] != before)
    session = view._explorer._clients[-1].session
    until(page, lambda: session.is_exact and session.shown >= session.wanted)
    page.wait_for_selector(REST, state="attached")
    page.wait_for_timeout(200)


def letters(page):
    """Right, left, upper and lower border."""
    return page.locator(".vlm-letter").all_text_contents()


def test_letters_and_views_follow_the_patient(tab):
    view, page, volume = tab
    until(page, lambda: letters(page) == ["L", "R", "S", "I"])
    for key, name, seen in (
        ("L", "left", ["P", "A", "S", "I"]),
        ("S", "superior", ["R", "L", "A", "P"]),
        ("Y", "anterior", ["L", "R", "S", "I"]),  # the end of an axis has its letter
    ):
        press(view, page, key)
        until(page, lambda seen=seen: letters(page) == seen)
        camera, wanted = view.camera, view_angles(volume.meta, name)
        found = {angle: getattr(camera, angle) for angle in wanted}
        assert found == pytest.approx(wanted, abs=1e-6)
    page.get_by_role("tab", name="Views").click()
    page.get_by_role("button", name="posterior", exact=True).click()
    until(page, lambda: letters(page) == ["R", "L", "S", "I"])
    names = page.locator(".vlm-end").evaluate_all("all => all.map((e) => e.textContent.at(-1))")
    assert sorted(names) == sorted("LRPASI")
    press(view, page, "A")


def test_measures_by_keyboard_are_those_of_python(tab):
    view, page, volume = tab
    page.locator(".vlm-canvas").focus()
    page.keyboard.press("d")
    page.wait_for_function("document.querySelector('.vlm-aiming')")
    page.keyboard.press("p")  # the middle ray meets the ball at its front
    page.get_by_text("Click the last point").wait_for()
    press(view, page, "L")
    page.keyboard.press("p")
    until(page, lambda: len(settings(view)["measures"]) == 1)
    (front, left), cell = settings(view)["measures"][0]["points"], 30 / 24
    # The middle of a picture with even numbers of pixels is half a pixel off a ray.
    np.testing.assert_allclose(front, [0, -RADIUS, 0], atol=0.1 * cell)
    np.testing.assert_allclose(left, [RADIUS, 0, 0], atol=0.1 * cell)
    panel = page.get_by_role("tabpanel", name="Measure")
    length = np.linalg.norm(np.subtract(front, left))
    words = page.locator(".vlm-measured text", has_text="m").text_content().split()
    assert float(words[0]) * {"mm": 1, "cm": 10, "m": 1000}[words[1]] == pytest.approx(length, 1e-3)

    page.keyboard.press("V")
    until(page, lambda: len(settings(view)["measures"]) == 2)
    page.keyboard.press("B")
    until(page, lambda: len(settings(view)["measures"]) == 3)
    _, shown, box = settings(view)["measures"]
    assert shown["where"] == "depth >= 10"
    region = vm.regions.Box(box["low"], box["high"])
    for options in ({"where": shown["where"]}, {"clip": region}):
        wanted = vm.measure(volume, "depth", **options)
        panel.get_by_text(str(wanted.cells), exact=True).wait_for()
        panel.get_by_text(f"{wanted.means['depth']:.4g}", exact=True).wait_for()

    # From behind the first point is hidden: the line is dashed, and gone if the other is, too.
    until(page, lambda: page.locator(".vlm-measured").count() == 3)
    press(view, page, "P")
    page.locator(".vlm-partly").wait_for(state="attached")
    for _ in range(8):
        press(view, page, "ArrowLeft")
    until(page, lambda: page.locator(".vlm-measured").count() == 2)
    press(view, page, "A")
    until(page, lambda: page.locator(".vlm-measured").count() == 3)

    panel.get_by_role("button", name="Remove: Distance").click()
    until(page, lambda: page.locator(".vlm-measured").count() == 2)
    page.locator(".vlm-canvas").focus()
    page.keyboard.press("u")
    until(page, lambda: page.locator(".vlm-measured").count() == 3)
