"""The explorer as a page: four constant files and one websocket (ASGI), served by uvicorn."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import socket
import stat
import tempfile
import threading
import time
import webbrowser
from collections.abc import Awaitable, Callable, Iterable
from concurrent.futures import Future
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, unquote

from ..errors import InputError, VoluminousError
from ..packages import require
from .frames import packed
from .guard import SUBPROTOCOL, Guard

if TYPE_CHECKING:
    from .explorer import Client, Explorer

Receive = Callable[[], Awaitable[dict[str, Any]]]
Transmit = Callable[[dict[str, Any]], Awaitable[None]]

_FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/explorer.js": ("explorer.js", "text/javascript; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/explorer.css": ("explorer.css", "text/css; charset=utf-8"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
}
_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
_MOST_PAGES = 64
_LONGEST_MESSAGE = 1 << 20
# What tells that this is a job of Slurm, PBS or LSF, and where it was submitted.
_SUBMITTED = {
    "SLURM_JOB_ID": "SLURM_SUBMIT_HOST",
    "PBS_JOBID": "PBS_O_HOST",
    "LSB_JOBID": "LSB_SUB_HOST",
}
# Bytes of a folder's name: that of a socket has at most about a hundred.
_LONGEST_FOLDER = 60
# Seconds without a page, after which the server ends.
IDLE = 3600.0


class App:
    """The ASGI application: every request passes here, and here alone."""

    def __init__(
        self, explorer: Future[Explorer], guard: Guard, base: str = "", name: str = ""
    ) -> None:
        self.explorer, self.guard, self.base, self.name = explorer, guard, base, name
        self.pages, self.refused = 0, threading.Event()
        folder = resources.files(__package__) / "static"
        self.files = {
            path: ((folder / name).read_bytes(), kind) for path, (name, kind) in _FILES.items()
        }

    async def __call__(self, scope: dict[str, Any], receive: Receive, send: Transmit) -> None:
        if scope["type"] == "http":
            await self._give(scope, send)
        elif scope["type"] == "websocket":
            await self._talk(scope, receive, send)

    async def _give(self, scope: dict[str, Any], send: Transmit) -> None:
        headers = _headers(scope)
        host = headers.get("host", "")
        content, kind, status = b"not found", "text/plain; charset=utf-8", 404
        path, more = self._path(scope), {}
        if not (
            self.guard.knows_host(host) and self.guard.knows_origin(headers.get("origin"), host)
        ):
            content, status = b"this host or origin is not served", 403
        elif scope["method"] not in ("GET", "HEAD"):
            content, status = b"only GET is served", 405
        elif path in self.files:
            (content, kind), status = self.files[path], 200
        elif self.base and scope["path"] == self.base:
            query = scope["query_string"].decode("latin-1")
            more, status = {"location": f"{quote(self.base)}/{'?' * bool(query)}{query}"}, 307
        headers = {**_HEADERS, **more, "content-type": kind, "content-length": str(len(content))}
        pairs = [(name.encode(), value.encode()) for name, value in headers.items()]
        await send({"type": "http.response.start", "status": status, "headers": pairs})
        body = b"" if scope["method"] == "HEAD" else content
        await send({"type": "http.response.body", "body": body})

    def _path(self, scope: dict[str, Any]) -> str:
        path: str = scope["path"]
        return path[len(self.base) :] if path.startswith(f"{self.base}/") else path

    async def _talk(self, scope: dict[str, Any], receive: Receive, send: Transmit) -> None:
        if (await receive())["type"] != "websocket.connect":
            return
        headers = _headers(scope)
        allowed = self._path(scope) == "/ws" and self.guard.lets_in(
            headers.get("host", ""), headers.get("origin"), scope.get("subprotocols", ())
        )
        if not allowed:
            await send({"type": "websocket.close", "code": 1008})  # before accept: HTTP 403
            return
        await send({"type": "websocket.accept", "subprotocol": SUBPROTOCOL})
        if self.pages >= _MOST_PAGES:
            why = f"{_MOST_PAGES} pages are open: close some"
            await send({"type": "websocket.close", "code": 1013, "reason": why})
            return
        outbox: asyncio.Queue[bytes | str] = asyncio.Queue()
        loop = asyncio.get_running_loop()

        def pass_on(message: dict[str, Any], payload: bytes) -> None:
            block: bytes | str = packed(message, payload) if payload else json.dumps(message)
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(outbox.put_nowait, block)

        self.pages += 1
        writer, client = asyncio.create_task(_write(outbox, send)), None
        try:
            if not self.explorer.done():
                pass_on({"kind": "opening", "name": self.name}, b"")
            try:
                explorer = await asyncio.shield(asyncio.wrap_future(self.explorer))
            except Exception as error:
                words = str(error) if isinstance(error, (VoluminousError, OSError)) else ""
                words = words or f"{type(error).__name__}: {error}"
                text = json.dumps({"kind": "notice", "level": "error", "text": words})
                await send({"type": "websocket.send", "text": text})
                await send({"type": "websocket.close", "code": 1011})
                self.refused.set()
                return
            client = explorer.connect(pass_on)
            while (event := await receive())["type"] == "websocket.receive":
                # One at a time, and not in this thread: other pages are heard meanwhile.
                await asyncio.to_thread(_take, client, event.get("text"))
        finally:
            self.pages -= 1
            writer.cancel()
            if client is not None:
                client.close()


def _take(client: Client, text: str | None) -> None:
    try:
        message = json.loads(text or "")
    except (ValueError, RecursionError):
        message = None
    client.receive(message)


async def _write(outbox: asyncio.Queue[bytes | str], send: Transmit) -> None:
    with contextlib.suppress(Exception):  # the page is gone
        while True:
            block = await outbox.get()
            key = "bytes" if isinstance(block, bytes) else "text"
            await send({"type": "websocket.send", key: block})


def _headers(scope: dict[str, Any]) -> dict[str, str]:
    return {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}


class Server:
    """A running server of one explorer.

    Parameters
    ----------
    explorer : Explorer, optional
        Without one pages wait for `show`, or `refuse`.
    name : str
        What is being opened.
    port : int
        0 for any that is free. Only this machine's own address is served.
    unix_socket : bool
        Serve a socket in a folder that only this user can enter, for ``ssh -L``.
    hosts : iterable of str
        Names under which a proxy serves this machine.
    base_path : str
        Path under which a proxy serves the page, which may keep or strip it.
    idle : float
        Seconds without a page, after which it ends.

    Attributes
    ----------
    url : str
        What to open, with the token in the part that browsers do not send.
    """

    def __init__(
        self,
        explorer: Explorer | None = None,
        *,
        name: str = "",
        port: int = 0,
        unix_socket: bool = False,
        hosts: Iterable[str] = (),
        base_path: str = "/",
        idle: float = IDLE,
    ) -> None:
        uvicorn = require("uvicorn", "view", "the explorer")
        require("websockets", "view", "the explorer")
        self.idle = idle
        self.explorer: Explorer | None = None
        self._opening: Future[Explorer] = Future()
        if explorer is not None:
            self.show(explorer)
        base = unquote(base_path).removesuffix("/")
        if not re.fullmatch(r"(/(?!\.\.?(/|$))[\w.~@+-]+)*", base):
            raise InputError(f"a base path is one such as /volume/, got {base_path!r}")
        self.socket_path: Path | None = None
        if unix_socket:
            self._socket, self.socket_path = _unix_socket()
            self.port = 8080
        else:
            self._socket = _loopback(port)
            self.port = self._socket.getsockname()[1]
        self.guard = Guard(hosts, 0 if unix_socket else port)
        self.url = f"http://127.0.0.1:{self.port}{quote(base)}/#token={self.guard.token}"
        self._app = App(self._opening, self.guard, base, name)
        self._server = uvicorn.Server(
            uvicorn.Config(
                self._app,
                log_level="warning",
                access_log=False,
                ws_max_size=_LONGEST_MESSAGE,
                ws_per_message_deflate=False,
                lifespan="off",
                server_header=False,
            )
        )
        # Not the thread itself is waited for: Ctrl-C during Thread.join marks it as ended.
        self._ended = threading.Event()

    def show(self, explorer: Explorer) -> None:
        """Let pages in."""
        self.explorer = explorer
        self._opening.set_result(explorer)

    def refuse(self, error: Exception, seconds: float) -> None:
        """Tell pages why there is nothing to see, those too that come within some seconds."""
        self._opening.set_exception(error)
        self._app.refused.wait(seconds)

    def start(self) -> None:
        """Serve in a thread; returns when it listens."""
        threading.Thread(target=self._run, name="server", daemon=True).start()
        while not self._server.started and not self._ended.is_set():
            time.sleep(0.005)

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        finally:
            self._ended.set()

    async def _serve(self) -> None:
        watch = asyncio.create_task(self._watch())
        try:
            await self._server.serve(sockets=[self._socket])
        finally:
            watch.cancel()
            if self.socket_path is not None:
                self.socket_path.unlink(missing_ok=True)
                self.socket_path.parent.rmdir()

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(min(1.0, self.idle))
            explorer = self.explorer
            if explorer is None or explorer.pages:
                continue
            if time.monotonic() - explorer.active_at > self.idle:
                self._server.should_exit = True

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until it has ended; return whether it has."""
        return self._ended.wait(seconds)

    def close(self) -> None:
        """End."""
        self._opening.cancel()
        self._server.should_exit = True
        self._ended.wait(5.0)

    def open_browser(self) -> None:
        """Open the page. The token is in no command line, which others could list."""
        folder = Path(tempfile.mkdtemp(prefix="voluminous-"))
        redirect = folder / "open.html"
        redirect.touch(0o600)
        redirect.write_text(
            f'<!doctype html><meta http-equiv="refresh" content="0; url={self.url}">'
        )
        webbrowser.open(redirect.as_uri())

    @property
    def needs_tunnel(self) -> bool:
        """Whether the user probably sits at another machine."""
        return bool(self.socket_path or _login() or _job())

    def instructions(self) -> str:
        """Return what to do to see the page, from another machine too."""
        if not self.needs_tunnel:
            return f"The explorer is at\n  {self.url}"
        there = str(self.socket_path or f"127.0.0.1:{self.port}")
        user = f"{name}@" if (name := os.environ.get("USER", "")) else ""
        host, jump = _login() or socket.gethostname(), ""
        if job := _job():
            # It has inherited the connection of the login node.
            jump = f"-J {user}{_login() or os.environ.get(_SUBMITTED[job], 'LOGIN')} "
            host = socket.gethostname()
        return (
            f"On your own machine run\n  ssh -N {jump}-L {self.port}:{there} {user}{host}\n"
            f"and open\n  {self.url}"
        )


def _login() -> str:
    connection = os.environ.get("SSH_CONNECTION", "").split()
    return connection[2] if len(connection) == 4 else ""


def _job() -> str:
    return next((name for name in _SUBMITTED if name in os.environ), "")


def _loopback(port: int) -> socket.socket:
    found = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        found.bind(("127.0.0.1", port))
    except OSError as error:
        found.close()
        raise InputError(f"port {port} is not free; leave out --port, or give another") from error
    return found


def _unix_socket() -> tuple[socket.socket, Path]:
    if not hasattr(socket, "AF_UNIX"):
        raise InputError("this system has no unix sockets; leave out --socket")
    # A job may have inherited the name of a folder that is only on the login node.
    for base in (os.environ.get("XDG_RUNTIME_DIR", ""), tempfile.gettempdir(), "/tmp"):
        if os.access(base, os.W_OK) and len(os.fsencode(base)) <= _LONGEST_FOLDER:
            break
    folder = Path(tempfile.mkdtemp(prefix="voluminous-", dir=base))
    folder.chmod(stat.S_IRWXU)
    path = folder / "view.sock"
    found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    found.bind(str(path))
    path.chmod(stat.S_IRUSR | stat.S_IWUSR)
    return found, path
