"""The explorer in JupyterLab and marimo, in a real browser: the same picture as Python's."""

from __future__ import annotations

import io
import time
from base64 import b64decode

import numpy as np
import pytest

import chromium
import notebook_hosts
import voluminous as vm
from voluminous.rendering import framed

pytest.importorskip("playwright.sync_api")
if chromium.PATH is None:
    pytest.skip("there is no chromium", allow_module_level=True)

CODE = """
import voluminous as vm
volume = vm.models.prestellar_core(32)
vm.view(volume)
"""
SECONDS = 90.0


@pytest.fixture(scope="module")
def browser():
    with chromium.launched() as browser:
        yield browser


def pixels(canvas):
    """Return what a canvas holds, row 0 at the bottom."""
    from PIL import Image

    url = canvas.evaluate("canvas => canvas.toDataURL()")
    picture = Image.open(io.BytesIO(b64decode(url.partition(",")[2])))
    return np.asarray(picture.convert("RGB"))[::-1] / 255.0


def python(size):
    """Return what Python draws of the first view of a page of this size."""
    volume = vm.models.prestellar_core(32)
    medium = vm.suggest_medium(volume)
    camera = framed(volume, medium, resolution=size)
    return vm.render(volume, medium, camera).to_rgb()


@pytest.mark.parametrize("host", notebook_hosts.HOSTS)
def test_a_notebook_shows_the_picture_and_follows_the_hand(host, browser, tmp_path):
    if not notebook_hosts.is_installed(host):
        pytest.skip(f"{host} is not installed")
    with notebook_hosts.notebook(host, CODE, tmp_path) as address:
        page = browser.new_page(viewport={"width": 1000, "height": 700})
        page.set_default_timeout(1000 * SECONDS)
        errors = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(address)
        notebook_hosts.run_cell(host, page)
        exact = page.locator("[data-exact=true]")
        exact.wait_for(state="attached")
        canvas = exact.locator("canvas").first
        assert canvas.evaluate("c => !c.getContext('webgl2').isContextLost()")
        page.wait_for_timeout(400)  # one picture fades into the next
        first = pixels(canvas)
        wanted = python((first.shape[1], first.shape[0]))
        assert wanted.std() > 0.05  # not flat
        assert np.abs(first - wanted).max() * 255 <= 2.0

        root = page.locator("[data-frame]")
        frame = int(root.get_attribute("data-frame"))
        canvas.scroll_into_view_if_needed()
        box = canvas.bounding_box()
        x, y = box["x"] + 0.4 * box["width"], box["y"] + 0.5 * box["height"]
        page.mouse.move(x, y)
        page.mouse.down()
        end, k = time.monotonic() + SECONDS, 0
        while k < 40 or int(root.get_attribute("data-frame")) == frame:
            assert time.monotonic() < end
            k += 1
            page.mouse.move(x + 2 * k, y + k)
            page.wait_for_timeout(16)
        page.mouse.up()
        page.wait_for_selector("[data-exact=false]", state="attached")
        exact.wait_for(state="attached")
        page.wait_for_timeout(400)
        second = pixels(canvas)
        assert second.std() > 0.05
        assert np.abs(second - first).max() > 0.1
        assert errors == []
        page.close()
