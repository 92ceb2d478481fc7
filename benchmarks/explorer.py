"""Time the explorer in a real browser: from a moving hand to the picture on the screen.

    python benchmarks/explorer.py --cells 128 --size 400
    python benchmarks/explorer.py --rate 20 --delay 40     # a link: Mbit/s, ms there and back
    python benchmarks/explorer.py --host jupyterlab        # or marimo: in a notebook's cell
    python benchmarks/explorer.py --clients 8 --minutes 10 # rates and memory, without a browser
    python benchmarks/explorer.py --file large.npy         # a new process, voluminous view

Browser, kernel and encoder share the machine. A number is the time from the message of an input to
the drawing of the first frame that shows it or a later one.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

import voluminous as vm

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import chromium
import notebook_hosts

# Notes when each input is sent, by whatever way the host has, and when each frame is drawn: the
# explorer marks a frame when it has come, and draws it in the screen's next frame.
WATCH = r"""
window.sent = {}; window.drawn = [];
const note = (data, at) => {
  const text = typeof data === 'string' ? data : new TextDecoder().decode(data);
  for (const [, n] of text.matchAll(/kind\W+look\W+n\W+(\d+)/g)) window.sent[n] ??= at;
};
const { send } = WebSocket.prototype, { fetch } = window, { attachShadow } = Element.prototype;
WebSocket.prototype.send = function (data) {
  note(data, performance.now());
  return send.call(this, data);
};
window.fetch = function (what, how) {
  const at = performance.now();
  if (typeof how?.body === 'string') note(how.body, at);
  else if (what instanceof Request) what.clone().text().then((text) => note(text, at));
  return fetch.call(this, what, how);
};
const watch = (root) => new MutationObserver((changes) => {
  for (const { target } of changes) {
    const n = Number(target.dataset.n);
    requestAnimationFrame(() => window.drawn.push([n, performance.now()]));
  }
}).observe(root, { subtree: true, attributes: true, attributeFilter: ['data-frame'] });
Element.prototype.attachShadow = function (how) {
  const root = attachShadow.call(this, how);
  watch(root);
  return root;
};
document.addEventListener('DOMContentLoaded', () => watch(document.body));
"""
CELL = """
import voluminous as vm
volume = vm.models.prestellar_core({cells})
vm.view(volume, vm.suggest_medium(volume).calibrated(volume))
"""
# Width and height of what stands around the canvas: without a graphics card every pixel of a window
# is drawn by the processor.
AROUND = {"page": (348, 43), "jupyterlab": (300, 200), "marimo": (300, 100)}
# Seconds after which memory is at rest.
WARM = 60.0


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
    """Measure one page, or many clients."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=128)
    parser.add_argument("--size", type=int, default=400)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--host", choices=("page", *notebook_hosts.HOSTS), default="page")
    parser.add_argument("--rate", type=float, help="of the link, Mbit/s")
    parser.add_argument("--delay", type=float, default=0.0, help="there and back, ms")
    parser.add_argument("--clients", type=int, help="that drag at the same time, for --minutes")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--file", help="that voluminous view opens in a new process")
    args = parser.parse_args()
    if args.file:
        asyncio.run(from_the_start(args))
    elif args.clients:
        load(args)
    else:
        one_page(args)


@contextmanager
def served(args: Any) -> Iterator[str]:
    """Give the address of an explorer."""
    if args.host != "page":
        with tempfile.TemporaryDirectory() as folder:
            code = CELL.format(cells=args.cells)
            with notebook_hosts.notebook(args.host, code, Path(folder)) as url:
                yield url
        return
    view = opened(args)
    url = view.url
    if args.rate:
        port = view._server.port
        url = url.replace(f":{port}", f":{Link(port, args.rate, args.delay).own}")
    yield url
    view.close()


def opened(args: Any) -> vm.viewer.views.View:
    """Return an explorer in this process."""
    volume = vm.models.prestellar_core(args.cells)
    medium = vm.suggest_medium(volume).calibrated(volume)
    return vm.view(volume, medium, notebook=False, browser=False)


def one_page(args: Any) -> None:
    """Drag for a while, and print times and rates."""
    start = time.perf_counter()
    with served(args) as url, chromium.launched() as browser:
        wider, higher = AROUND[args.host]
        page = browser.new_page(viewport={"width": args.size + wider, "height": args.size + higher})
        page.set_default_timeout(120_000)
        page.add_init_script(WATCH)
        page.goto(url)
        notebook_hosts.run_cell(args.host, page)
        page.wait_for_selector("[data-frame]", state="attached")
        print(f"first picture {time.perf_counter() - start:.2f} s")
        stage, side = page.locator(".vlm-stage").first, f"{args.size}px"
        stage.evaluate(
            "(e, side) => Object.assign(e.style, { width: side, height: side, flex: 'none' })", side
        )
        page.wait_for_timeout(500)
        page.wait_for_selector("[data-exact=true]", state="attached")
        print(f"exact picture {time.perf_counter() - start:.2f} s")
        canvas = page.locator("canvas").first
        canvas.scroll_into_view_if_needed()
        box = canvas.bounding_box()
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
        page.wait_for_timeout(100)
        page.wait_for_selector("[data-exact=true]", state="attached")
        print(f"exact again after {time.perf_counter() - start:.2f} s")
        browser.close()


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
    load = psutil.getloadavg()[0]
    print(
        f"{name}: p50 {middle:.0f} ms, p95 {most:.0f} ms, {rate:.1f} frames a second "
        f"({len(at)} inputs, load {load:.1f})"
    )


def load(args: Any) -> None:
    """Let one client drag, then many; print rates, and memory while they do."""
    view, process = opened(args), psutil.Process()

    def memory() -> float:
        return process.memory_info().rss / 1e6

    alone = sum(drag(view.url, args.size, 1, 20.0)) / 20.0
    before = memory()
    print(f"one client: {alone:.1f} frames a second; {before:.0f} MB")
    seconds = 60.0 * args.minutes
    rates: list[list[float]] = []
    dragging = threading.Thread(
        target=lambda: rates.append(drag(view.url, args.size, args.clients, seconds))
    )
    dragging.start()
    start, seen = time.monotonic(), []
    while dragging.is_alive():
        dragging.join(10.0)
        seen.append((time.monotonic() - start, memory()))
    warm = next((m for t, m in seen if t >= min(WARM, 0.2 * seconds)), seen[-1][1])
    last = [m for t, m in seen if t <= seconds][-1]
    each = [n / seconds for n in rates[0]]
    print(
        f"{args.clients} clients for {args.minutes:g} minutes: {min(each):.2f} to {max(each):.2f} "
        f"frames a second each ({min(each) * args.clients / alone:.2f} of a fair share)\n"
        f"memory {warm:.0f} MB warm, {last:.0f} MB at the end ({100 * (last / warm - 1):+.1f} %); "
        f"{(last - before) / args.clients:.2f} MB more for each client; load "
        f"{psutil.getloadavg()[0]:.1f}"
    )
    print("  ".join(f"{t / 60:.1f}: {m:.0f}" for t, m in seen[:: max(1, len(seen) // 12)]))
    view.close()


def drag(url: str, size: int, clients: int, seconds: float) -> list[float]:
    """Return how many frames each client was sent; the clients have a process of their own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_drag_all, (url, size, clients, seconds))


def _drag_all(url: str, size: int, clients: int, seconds: float) -> list[float]:
    async def all_of_them() -> list[float]:
        return await asyncio.gather(*(_client(url, size, seconds) for _ in range(clients)))

    return asyncio.run(all_of_them())


async def from_the_start(args: Any) -> None:
    """Print when the address, the first picture and the exact ones come, by wall and processor.

    The hand drags from the first picture on, and once more after the exact one.
    """
    from voluminous.viewer.frames import unpacked

    start, command = time.monotonic(), [sys.executable, "-m", "voluminous", "view", args.file]
    program = await asyncio.create_subprocess_exec(
        *command, "--no-browser", stdout=asyncio.subprocess.PIPE
    )
    process = psutil.Process(program.pid)

    def spent() -> tuple[float, float]:
        times = process.cpu_times()
        return time.monotonic() - start, times.user + times.system

    def note(what: str) -> None:
        wall, processor = spent()
        print(f"{wall:7.2f} s, processor {processor:7.2f} s: {what}", flush=True)

    url = ""
    while "#token=" not in url:
        url = (await program.stdout.readline()).decode().strip()
    note("address")
    seen: list[tuple[float, dict[str, Any]]] = []
    async with _connected(url) as socket:
        await socket.send(_hello(args.size))
        while json.loads(welcome := await socket.recv())["kind"] != "welcome":
            pass
        camera, exact, n = json.loads(welcome)["document"]["camera"], asyncio.Event(), 0

        async def answer() -> None:
            async for block in socket:
                if isinstance(block, bytes):
                    head = unpacked(block)[0]
                    if not seen or head["exact"] or (head["scale"] == 1 and head["done"] == 0):
                        kind = "exact" if head["exact"] else "picture"
                        note(f"{kind} of every {head['every']}, {head['width']} pixels")
                    seen.append((time.monotonic(), head))
                    _ = exact.set() if head["exact"] else exact.clear()
                    await socket.send(json.dumps({"kind": "seen", "frame": head["number"]}))

        answering = asyncio.create_task(answer())
        while not seen:
            await asyncio.sleep(0.01)
        for _ in range(2):
            first, sent, end = len(seen), {}, time.monotonic() + args.seconds
            before = spent()
            while time.monotonic() < end:
                n += 1
                sent[n] = time.monotonic()
                look = {"camera": {**camera, "phi": float(n % 360)}, "moving": True}
                await socket.send(json.dumps({"kind": "look", "n": n, **look}))
                await asyncio.sleep(1 / 60)
            after = spent()
            took = [1e3 * (at - sent[m["n"]]) for at, m in seen[first:] if m["n"] in sent]
            part = (after[1] - before[1]) / (after[0] - before[0])
            note(
                f"drag: {len(took) / args.seconds:.1f} frames a second, p50 "
                f"{np.median(took):.0f} ms, p95 {np.quantile(took, 0.95):.0f} ms, {part:.2f} cores"
            )
            n, _ = n + 1, exact.clear()
            await socket.send(json.dumps({"kind": "look", "n": n, **look, "moving": False}))
            while not (exact.is_set() and seen[-1][1]["n"] == n):
                await asyncio.sleep(0.01)
        answering.cancel()
    print(f"memory {process.memory_info().rss / 1e9:.2f} GB, load {psutil.getloadavg()[0]:.1f}")
    program.terminate()
    await program.wait()


def _connected(url: str) -> Any:
    from websockets.asyncio.client import connect

    address, _, token = url.replace("http", "ws", 1).partition("#token=")
    protocols = ["voluminous.v1", f"token.{token}"]
    return connect(f"{address}ws", subprotocols=protocols, max_size=None)


def _hello(size: int) -> str:
    return json.dumps({"kind": "hello", "protocol": 1, "size": [size, size], "scale": 1})


async def _client(url: str, size: int, seconds: float) -> float:
    from voluminous.viewer.frames import unpacked

    async with _connected(url) as socket:
        await socket.send(_hello(size))
        welcome = json.loads(await socket.recv())
        camera = welcome["document"]["camera"]
        frames = 0

        async def answer() -> None:
            nonlocal frames
            async for block in socket:
                if isinstance(block, bytes):
                    frames += 1
                    number = unpacked(block)[0]["number"]
                    await socket.send(json.dumps({"kind": "seen", "frame": number}))

        answering = asyncio.create_task(answer())
        end, n = time.monotonic() + seconds, 0
        while time.monotonic() < end:
            n += 1
            look = {**camera, "phi": float(n % 360)}
            await socket.send(json.dumps({"kind": "look", "n": n, "camera": look, "moving": True}))
            await asyncio.sleep(1 / 60)
        answering.cancel()
        return frames


if __name__ == "__main__":
    main()
