"""Time the explorer in a real browser: from a moving hand to the picture on the screen.

    python benchmarks/explorer.py --cells 128 --size 400
    python benchmarks/explorer.py --rate 20 --delay 40     # a link: Mbit/s, ms there and back

Browser, kernel and encoder share the machine. A number is the time from the message of an input to
the first frame on the screen that shows it or a later one.
"""

from __future__ import annotations

import argparse
import asyncio
import shutil
import threading
import time
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

import voluminous as vm

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
# Notes when each input is sent, and when each frame is drawn.
WATCH = """
window.sent = {}; window.drawn = []; window.bytes = 0;
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (data) {
  const m = typeof data === 'string' ? JSON.parse(data) : {};
  if (m.n) window.sent[m.n] ??= performance.now();
  return send.call(this, data);
};
document.addEventListener('DOMContentLoaded', () => {
  new MutationObserver((changes) => { for (const c of changes) if (c.target.dataset?.n)
    window.drawn.push([Number(c.target.dataset.n), performance.now()]); }
  ).observe(document.body, { subtree: true, attributes: true, attributeFilter: ['data-frame'] });
});
"""


class Link:
    """A proxy that delays what passes, and lets only so much of it pass: 50 ms of it may wait."""

    def __init__(self, port: int, rate: float, delay: float) -> None:
        self.port, self.rate, self.delay = port, rate * 1e6 / 8, delay / 2000.0
        self.listening = threading.Event()
        threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True).start()
        self.listening.wait()

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._join, "127.0.0.1", 0)
        self.own = server.sockets[0].getsockname()[1]
        self.listening.set()
        await server.serve_forever()

    async def _join(self, reader: Any, writer: Any) -> None:
        there = await asyncio.open_connection("127.0.0.1", self.port)
        await asyncio.gather(self._pass(reader, there[1]), self._pass(there[0], writer))

    async def _pass(self, reader: Any, writer: Any) -> None:
        free = time.monotonic()
        loop = asyncio.get_running_loop()
        while data := await reader.read(4096):
            free = max(free, time.monotonic()) + len(data) / self.rate
            loop.call_at(loop.time() + free - time.monotonic() + self.delay, writer.write, data)
            if (ahead := free - time.monotonic()) > 0.05:
                await asyncio.sleep(ahead - 0.05)
        writer.close()


def main() -> None:
    """Drag for a while, edit for a while, and print times and rates."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=128)
    parser.add_argument("--size", type=int, default=400)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rate", type=float, help="of the link, Mbit/s")
    parser.add_argument("--delay", type=float, default=0.0, help="there and back, ms")
    args = parser.parse_args()
    volume = vm.models.prestellar_core(args.cells)
    medium = vm.suggest_medium(volume).calibrated(volume)
    start = time.perf_counter()
    view = vm.view(volume, medium, notebook=False, browser=False)
    url = view.url
    if args.rate:
        url = url.replace(
            f":{view._server.port}", f":{Link(view._server.port, args.rate, args.delay).own}"
        )
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        page = browser.new_page(viewport={"width": args.size + 348, "height": args.size + 43})
        page.add_init_script(WATCH)
        page.goto(url)
        page.wait_for_selector("[data-frame]", state="attached")
        print(f"first picture {time.perf_counter() - start:.2f} s")
        page.wait_for_selector("[data-exact=true]", state="attached")
        print(f"exact picture {time.perf_counter() - start:.2f} s")
        box = page.locator("canvas").first.bounding_box()
        print(f"canvas {box['width']:.0f} x {box['height']:.0f}")
        x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
        page.mouse.move(x, y)
        page.mouse.down()
        page.evaluate("() => { window.sent = {}; window.drawn = []; }")
        end, k = time.monotonic() + args.seconds, 0
        while time.monotonic() < end:
            k += 1
            page.mouse.move(x + 100 * np.sin(0.05 * k), y + 40 * np.sin(0.03 * k))
            page.wait_for_timeout(8)
        report("drag", page, args.seconds)
        page.mouse.up()
        start = time.perf_counter()
        page.wait_for_selector("[data-exact=true]", state="attached")
        print(f"exact again after {time.perf_counter() - start:.2f} s")
        browser.close()
    view.close()


def report(name: str, page: Any, seconds: float) -> None:
    """Print median and 95 % of the times, and the frames per second."""
    sent, drawn = page.evaluate("() => [window.sent, window.drawn]")
    at = sorted((int(n), t) for n, t in sent.items())
    took = []
    for n, t in at:
        later = [when for shown, when in drawn if shown >= n and when >= t]
        if later:
            took.append(min(later) - t)
    middle, most = np.quantile(took, [0.5, 0.95])
    rate = len(drawn) / seconds
    print(f"{name}: p50 {middle:.0f} ms, p95 {most:.0f} ms, {rate:.1f} frames a second")


if __name__ == "__main__":
    main()
