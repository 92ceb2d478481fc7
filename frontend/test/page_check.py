"""Checks of the page in a real browser, against renders of Python. Run: python test/page_check.py [--shots FOLDER]."""

from __future__ import annotations

import asyncio
import sys

import numpy as np
from fake_server import Fake, start
from playwright.async_api import async_playwright

import voluminous as vm

SHOTS = sys.argv[sys.argv.index("--shots") + 1] if "--shots" in sys.argv else None
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PIXELS = """() => { const c = document.querySelector('.vlm-canvas'); const gl = c.getContext('webgl2');
  const d = new Uint8Array(4 * c.width * c.height); gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.readPixels(0, 0, c.width, c.height, gl.RGBA, gl.UNSIGNED_BYTE, d);
  return [c.width, c.height, btoa(Array.from(d, (v) => String.fromCharCode(v)).join(''))]; }"""


async def pixels(page) -> np.ndarray:
    """What is on the canvas, row 0 at the bottom, from 0 to 1."""
    import base64

    width, height, data = await page.evaluate(PIXELS)
    return np.frombuffer(base64.b64decode(data), np.uint8).reshape(height, width, 4)[..., :3] / 255


async def shot(page, name: str) -> None:
    if SHOTS:
        await page.screenshot(path=f"{SHOTS}/fe_{name}.png")


async def until(page, name: str, value: str, seconds: float = 15.0) -> None:
    """Wait for what the page says of itself; its policy forbids Playwright's own waiting."""
    for _ in range(int(20 * seconds)):
        if await page.evaluate("(n) => document.querySelector('.vlm')?.dataset[n]", name) == value:
            return
        await page.wait_for_timeout(50)
    raise TimeoutError(f"{name} is not {value}")


async def settled(page, seconds: float = 25.0, rests: str = "true") -> None:
    """Wait until nothing is drawn or sent for a while, however busy the machine is."""
    quiet = 0
    for _ in range(int(20 * seconds)):
        await page.wait_for_timeout(50)
        frame, exact = await page.evaluate(
            "() => { const d = document.querySelector('.vlm').dataset; return [d.frame, d.exact]; }"
        )
        still = not FAKE[0].painting and frame == str(FAKE[0].numbers) and exact == rests
        quiet = quiet + 1 if still else 0
        if quiet == 16:
            return
    raise TimeoutError("the page does not come to rest")


def sent(fake: Fake, kind: str) -> list[dict]:
    return [m for m in fake.received if m["kind"] == kind]


def check(name: str, good: bool, words: object = "") -> None:
    print("ok  " if good else "FAIL", name, words, flush=True)
    FAILED.extend([] if good else [name])


FAILED: list[str] = []
FAKE: list[Fake] = []


async def same(page, fake: Fake, name: str, codes: float, percentile: float = 99.9) -> None:
    shown, expected = await pixels(page), fake.last.to_rgb(**fake.document["image"])
    fits = shown.shape == expected.shape
    off = np.percentile(np.abs(shown - expected), percentile) * 255 if fits else np.inf
    check(
        name, fits and shown.std() > 0.01 and off <= codes, f"off by {off:.1f} codes, {shown.shape}"
    )


async def main() -> None:
    fake = Fake(vm.models.prestellar_core(32), count=1)
    FAKE.append(fake)
    async with start(fake) as server, async_playwright() as play:
        port = server.sockets[0].getsockname()[1]
        browser = await play.chromium.launch(executable_path="/usr/bin/chromium", args=FLAGS)
        page = await browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme="dark")
        trouble: list[str] = []
        page.on(
            "console",
            lambda m: (
                m.type in ("error", "warning")
                and "GPU stall" not in m.text
                and trouble.append(m.text)
            ),
        )
        page.on("pageerror", lambda e: trouble.append(str(e)))
        fake.refines = False
        await page.goto(f"http://127.0.0.1:{port}/#token=secret")
        await settled(page, rests="false")
        await same(page, fake, "a preview is Image.to_rgb", 8, 99)
        fake.refines = True
        await page.locator(".vlm-canvas").focus()
        await page.keyboard.press("ArrowLeft")
        await page.keyboard.press("ArrowRight")
        await settled(page)
        await shot(page, "start")
        check("the token left the address", "secret" not in page.url)
        await same(page, fake, "exact frame is Image.to_rgb", 2)

        box = await page.locator(".vlm-canvas").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        before = len(sent(fake, "look"))
        await page.mouse.move(x, y)
        await page.mouse.down()
        for i in range(1, 13):
            await page.mouse.move(x + 9 * i, y - 3 * i)
            await page.wait_for_timeout(30)
        moving = len(sent(fake, "look")) - before
        await shot(page, "drag")
        await page.mouse.up()
        await settled(page)
        looks = sent(fake, "look")[before:]
        numbers = [m["n"] for m in looks]
        check(
            "a drag sends looks",
            moving >= 3 and looks[-1]["moving"] is False and numbers == sorted(numbers),
            moving,
        )
        check("dragging right turns phi up", looks[-1]["camera"]["phi"] > 30, looks[-1]["camera"])
        await same(page, fake, "after the drag", 2)

        await page.get_by_role("tab", name="Tone").click()
        tone = page.get_by_role("tabpanel", name="Tone")
        fake.received.clear()
        slider = page.get_by_label("Exposure")
        bar = await slider.bounding_box()
        await page.mouse.move(bar["x"] + bar["width"] / 2, bar["y"] + bar["height"] / 2)
        await page.mouse.down()
        dark = await pixels(page)
        for i in range(1, 8):
            await page.mouse.move(bar["x"] + bar["width"] / 2 + 3 * i, bar["y"] + 4)
            await page.wait_for_timeout(30)
        quiet = [m["kind"] for m in fake.received]
        bright = await pixels(page)
        await page.mouse.up()
        await page.wait_for_timeout(300)
        check("exposure sends nothing while dragged", quiet == [], quiet)
        check("exposure brightens", bright.mean() > 1.2 * dark.mean(), (dark.mean(), bright.mean()))
        check("exposure is set at the end", len(sent(fake, "set")) == 1, sent(fake, "set"))
        await settled(page)
        await same(page, fake, "with an exposure", 2)
        await shot(page, "tone")
        await page.get_by_label("Stretch").select_option("asinh")
        await page.wait_for_timeout(600)
        await settled(page)
        await same(page, fake, "with asinh", 2)
        await page.get_by_label("Stretch").select_option("log")
        await page.get_by_label("Too bright").select_option("clip")
        await settled(page)
        await same(page, fake, "with log and clip", 2)
        await page.get_by_label("Stretch").select_option("custom")
        await settled(page)
        await same(page, fake, "with a power", 2)
        await tone.get_by_label("Colormap").select_option("viridis")
        await page.wait_for_timeout(600)
        await settled(page)
        await same(page, fake, "with a colormap", 3)
        await shot(page, "colormap")
        await tone.get_by_label("logarithm of the values").check()
        await settled(page)
        await same(page, fake, "with a logarithmic colormap", 3)
        await page.keyboard.press("Control+z")
        await page.keyboard.press("Control+z")
        await page.get_by_role("button", name="Reset").click()
        await page.wait_for_timeout(400)

        await page.get_by_role("tab", name="Media").click()
        await settled(page)
        await shot(page, "media")
        handle = page.get_by_role("slider", name="centre")
        spot = await handle.bounding_box()
        fake.received.clear()
        await page.mouse.move(spot["x"] + spot["width"] / 2, spot["y"] + spot["height"] / 2)
        await page.mouse.down()
        for i in range(1, 6):
            await page.mouse.move(
                spot["x"] + spot["width"] / 2 + 5 * i, spot["y"] + spot["height"] / 2 - 2 * i
            )
            await page.wait_for_timeout(30)
        await page.mouse.up()
        await page.wait_for_timeout(300)
        sets = sent(fake, "set")
        check(
            "a peak is dragged",
            len(sets) >= 2
            and sets[-1]["moving"] is False
            and sets[-1]["patch"][0][0] == "medium.0.center",
            sets[-1:],
        )
        await handle.focus()
        await page.keyboard.press("ArrowRight")
        await page.wait_for_timeout(200)
        check("and moved by keys", len(sent(fake, "set")) == len(sets) + 1)
        check("handles speak", "optical depth" in (await handle.get_attribute("aria-valuetext")))
        await page.keyboard.press("u")
        await page.wait_for_timeout(300)
        check("undo", sent(fake, "undo") != [])
        count = len(fake.document["medium"])
        await page.get_by_role("button", name="Add", exact=True).click()
        await page.wait_for_timeout(300)
        check("a medium is added", len(fake.document["medium"]) == count + 1)
        await settled(page)
        await shot(page, "added")

        fake.received.clear()
        await page.mouse.click(x + 20, y + 10)
        await page.wait_for_selector(".vlm-figures path", timeout=20000)
        await page.wait_for_timeout(300)
        await shot(page, "probe")
        check("a click asks what the ray saw", len(sent(fake, "probe")) == 1)
        await page.get_by_role("button", name="Add a medium with this value").click()
        await page.wait_for_timeout(300)
        check("a picked value makes a medium", len(fake.document["medium"]) == count + 2)
        await page.get_by_role("button", name="Rotate about this").click()
        await page.mouse.move(x, y)
        await page.mouse.wheel(0, -300)
        await page.wait_for_timeout(700)
        await settled(page)
        await shot(page, "zoomed")
        await page.keyboard.press("o")
        await page.wait_for_timeout(500)
        await settled(page)
        await same(page, fake, "perspective", 2)
        await shot(page, "perspective")

        await page.keyboard.press("Shift+1")
        await page.get_by_role("tab", name="Views").click()
        check("a view is kept", await page.locator(".vlm-view").count() == 1)
        await page.wait_for_timeout(200)
        await shot(page, "views")
        await page.get_by_role("tab", name="Slices").click()
        await page.get_by_role("checkbox", name="three slices").check()
        await page.wait_for_timeout(700)
        await shot(page, "slice")
        await page.get_by_role("tab", name="Scene").click()
        await page.wait_for_timeout(900)
        await shot(page, "scene")
        await page.keyboard.press("?")
        await page.wait_for_timeout(200)
        await shot(page, "help")
        await page.keyboard.press("Escape")
        await page.keyboard.press("s")
        await page.wait_for_timeout(200)
        await shot(page, "save")
        formats = page.get_by_role("dialog", name="Save").get_by_label("Format").locator("option")
        check("formats to choose from", await formats.count() == 5)
        await page.keyboard.press("Escape")
        await page.get_by_role("tab", name="Media").click()

        fake.slow = 1.0
        await page.locator(".vlm-canvas").focus()
        await page.keyboard.press("ArrowRight")
        await page.wait_for_timeout(150)
        turned = sent(fake, "look")[-1]["camera"]
        fake.received.clear()
        for connection in list(server.connections):
            await connection.close()
        await page.wait_for_timeout(100)
        await until(page, "connection", "open", 5)
        await page.wait_for_timeout(800)
        fake.slow = 0.0
        check("says hello again", len(sent(fake, "hello")) == 1)
        check(
            "a camera that was not shown is asked for again",
            [m["camera"] for m in sent(fake, "look")] == [turned],
        )
        await settled(page)
        await same(page, fake, "after a cut connection", 2)

        for width, height in ((320, 640), (700, 900), (1600, 900)):
            await page.set_viewport_size({"width": width, "height": height})
            await page.wait_for_timeout(1200)
            await settled(page)
            await shot(page, f"{width}")
            wide = await page.evaluate("document.documentElement.scrollWidth - innerWidth")
            check(f"fits {width} px", wide <= 0, wide)
        await page.set_viewport_size({"width": 1280, "height": 800})
        await page.emulate_media(color_scheme="light")
        await page.wait_for_timeout(1000)
        await shot(page, "light")
        check("no errors in the console", trouble == [], trouble)
        await browser.close()
    print("failed:", FAILED or "nothing")
    sys.exit(bool(FAILED))


asyncio.run(main())
