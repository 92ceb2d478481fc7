"""The explorer's server: who is let in, what is served, and a page that comes back."""

from __future__ import annotations

import contextlib
import gzip
import hashlib
import http.client
import json
import os
import socket
import stat
import time
from pathlib import Path

import numpy as np
import pytest

import voluminous as vm
from voluminous.viewer import frames
from voluminous.viewer.explorer import Explorer
from voluminous.viewer.guard import SUBPROTOCOL, Guard
from voluminous.viewer.page import _FILES, Server

pytest.importorskip("uvicorn")
client = pytest.importorskip("websockets.sync.client")
exceptions = pytest.importorskip("websockets.exceptions")

VOLUME = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1)), a=np.ones((4, 4, 4)))
MEDIUM = vm.Coefficients("a", "a")
CAMERA = vm.Orthographic(60, 30, resolution=8)


@pytest.fixture(scope="module")
def server():
    explorer = Explorer(VOLUME, MEDIUM, CAMERA)
    server = Server(explorer)
    server.start()
    yield server
    server.close()
    explorer.close()


def connect(server, token=None, origin=None, path="/ws"):
    token = server.guard.token if token is None else token
    protocols = [SUBPROTOCOL, *([f"token.{token}"] if token else [])]
    return client.connect(
        f"ws://127.0.0.1:{server.port}{path}",
        subprotocols=protocols,
        origin=origin,
        max_size=None,
        proxy=None,
    )


def get(server, path, method="GET", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    return answer.status, dict(answer.getheaders()), answer.read()


ORIGINS = [None, "same", "http://evil.example", "http://127.0.0.1:{port}.evil.example", "null"]
HOSTS = ["127.0.0.1:{port}", "localhost:{port}", "evil.example", "127.0.0.1.evil.example"]


@pytest.mark.parametrize("token", ["right", "", "wrong", "x" * 43])
@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize("host", HOSTS)
def test_only_the_token_from_this_page_on_this_host_is_let_in(server, token, origin, host):
    guard, port = server.guard, server.port
    name = host.format(port=port)
    source = f"http://{name}" if origin == "same" else origin and origin.format(port=port)
    secret = guard.token if token == "right" else token
    allowed = token == "right" and origin in (None, "same") and host in HOSTS[:2]
    assert guard.lets_in(name, source, [SUBPROTOCOL, f"token.{secret}"]) is allowed
    assert not guard.lets_in(name, source, [SUBPROTOCOL])
    assert not guard.lets_in(name, source, [f"token.{secret}"])


@pytest.mark.parametrize("token", [None, "", "wrong"])
@pytest.mark.parametrize("origin", [None, "http://evil.example"])
def test_the_socket_asks_the_guard(server, token, origin):
    if token is None and origin is None:
        with connect(server) as page:
            page.send("3")
            assert json.loads(page.recv(timeout=10))["kind"] == "notice"
        return
    with pytest.raises(exceptions.InvalidStatus) as error:
        connect(server, token, origin=origin)
    assert error.value.response.status_code == 403


@pytest.mark.parametrize("path", ["/", "/ws/", "/other", "/ws/../ws"])
def test_there_is_one_websocket(server, path):
    with pytest.raises(exceptions.InvalidStatus) as error:
        connect(server, path=path)
    assert error.value.response.status_code in (403, 404)


def test_every_file_is_served_with_a_policy_and_nothing_else_is(server):
    for path in _FILES:
        status, headers, body = get(server, path)
        assert status == 200
        assert "default-src 'none'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert int(headers["content-length"]) == len(body)
        assert server.guard.token.encode() not in body
    for path in (
        "/../page.py",
        "/%2e%2e/page.py",
        "/static/explorer.js",
        "//explorer.js",
        "/ws",
    ):
        assert get(server, path)[0] == 404
    assert get(server, "/", "POST")[0] == 405
    assert get(server, "/", Host="evil.example")[0] == 403
    assert get(server, "/", Origin="http://evil.example")[0] == 403


def test_the_committed_bundle_is_that_of_the_sources():
    """`npm run build` in ``frontend`` makes it, and writes down of what."""
    root = Path(__file__).parent.parent
    folders = {"sources": root / "frontend/src", "bundle": root / "src/voluminous/viewer/static"}
    hashes = json.loads((root / "frontend/bundle.json").read_text())
    for name, folder in folders.items():
        digest = hashlib.sha256()
        files = {p.relative_to(folder).as_posix(): p for p in folder.rglob("*") if p.is_file()}
        for path in sorted(files):
            digest.update(path.encode() + b"\0" + files[path].read_bytes())
        assert hashes[name] == digest.hexdigest(), f"{name}: run npm run build in frontend"
    size = sum(len(gzip.compress(p.read_bytes())) for p in folders["bundle"].iterdir())
    assert size <= 60 << 10


def conversation(server):
    """Return a page's first exact picture."""
    with connect(server) as page:
        hello = {"kind": "hello", "protocol": 1, "size": [8, 8], "scale": 1}
        page.send(json.dumps(hello))
        for _ in range(50):
            message = page.recv(timeout=60)
            if isinstance(message, bytes):
                head, payload = frames.unpacked(message)
                page.send(json.dumps({"kind": "seen", "frame": head["number"]}))
                if head["exact"]:
                    return frames.from_float16(head, payload)
    raise AssertionError("no exact picture came")


def test_a_page_gets_its_picture_again_after_it_was_cut_off(server):
    image = vm.render(VOLUME, MEDIUM, CAMERA)
    for _ in range(2):
        np.testing.assert_allclose(conversation(server), image.intensity, rtol=2e-3, atol=1e-3)
    end = time.monotonic() + 10
    while server.explorer.pages and time.monotonic() < end:
        time.sleep(0.01)
    assert server.explorer.pages == 0


def test_what_is_no_message_is_answered_and_what_is_too_long_ends_it(server):
    with connect(server) as page:
        for text in ("{", "[" * 100_000, "3", '{"kind": 3}'):
            page.send(text)
            assert json.loads(page.recv(timeout=10))["level"] == "error"
        page.send("x" * (2 << 20))
        with pytest.raises(exceptions.ConnectionClosed):
            list(iter(page.recv, None))
    with connect(server) as page:
        page.send(b"bytes")
        with pytest.raises(exceptions.ConnectionClosed):
            page.recv(timeout=10)


def test_a_unix_socket_is_this_users_alone_and_goes_away(monkeypatch):
    # As a job on a node inherits it from the login node.
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/there-is-none")
    explorer = Explorer(VOLUME, MEDIUM, CAMERA)
    server = Server(explorer, unix_socket=True)
    server.start()
    path = server.socket_path
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert f"-L 8080:{path}" in server.instructions()
    with socket.socket(socket.AF_UNIX) as plain:
        plain.connect(str(path))
        plain.sendall(b"GET / HTTP/1.1\r\nHost: localhost:8080\r\nConnection: close\r\n\r\n")
        answer = b""
        while part := plain.recv(1 << 16):
            answer += part
    assert answer.startswith(b"HTTP/1.1 200")
    server.close()
    explorer.close()
    assert not path.parent.exists()


def test_a_server_that_nobody_looks_at_ends():
    explorer = Explorer(VOLUME, MEDIUM, CAMERA)
    server = Server(explorer, idle=0.05)
    server.start()
    assert server.wait(10)
    explorer.close()


def test_the_token_can_be_given_by_the_environment_and_must_be_long(monkeypatch):
    monkeypatch.setenv("VOLUMINOUS_TOKEN", "a" * 20)
    assert Guard().token == "a" * 20
    monkeypatch.setenv("VOLUMINOUS_TOKEN", "short")
    with pytest.raises(vm.InputError, match="20 characters"):
        Guard()


def test_a_port_that_is_taken(server):
    with contextlib.closing(socket.socket()) as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(vm.InputError, match="not free"):
            Server(server.explorer, port=port)


def test_instructions_for_another_machine(server, monkeypatch):
    monkeypatch.setitem(os.environ, "SSH_CONNECTION", "10.0.0.1 5 cluster.example 22")
    assert f"ssh -N -L {server.port}:127.0.0.1:{server.port}" in server.instructions()
    # A node of a cluster is reached by the machine where the job was submitted.
    monkeypatch.setenv("USER", "ada")
    monkeypatch.setenv("SLURM_JOB_ID", "1")
    monkeypatch.setattr(socket, "gethostname", lambda: "node042")
    line = "ssh -N -J ada@{} -L " + f"{server.port}:127.0.0.1:{server.port} ada@node042\n"
    assert line.format("cluster.example") in server.instructions()
    monkeypatch.delenv("SSH_CONNECTION")
    monkeypatch.setenv("SLURM_SUBMIT_HOST", "login1")
    assert line.format("login1") in server.instructions()
    monkeypatch.delenv("SLURM_JOB_ID")
    assert server.url in server.instructions()


def test_view_gives_what_is_on_the_screen(tmp_path):
    view = vm.view(VOLUME, MEDIUM, CAMERA, notebook=False, browser=False, tolerance=1e-2)
    assert repr(view.medium) == repr(MEDIUM)
    assert (view.camera.incl, view.camera.phi) == (60, 30)
    image = view.image(resolution=8)
    np.testing.assert_array_equal(
        image.intensity, vm.render(VOLUME, MEDIUM, CAMERA, tolerance=1e-2).intensity
    )
    view.scene.save(tmp_path / "scene.toml")
    assert repr(vm.Scene.load(tmp_path / "scene.toml").medium) == repr(MEDIUM)
    assert view.url.startswith("http://127.0.0.1:")
    view.close()


def test_a_widget_moves_the_same_messages():
    pytest.importorskip("anywidget")
    view = vm.view(VOLUME, MEDIUM, CAMERA, notebook=True)
    widget, sent = view._widget, []
    widget.send = lambda content, buffers: sent.append((content, buffers))
    hello = {"kind": "hello", "protocol": 1, "size": [8, 8], "scale": 1}
    widget._receive(widget, hello, [])
    end = time.monotonic() + 60
    while not any(c["kind"] == "frame" and c["exact"] for c, _ in sent):
        assert time.monotonic() < end
        for content, _ in list(sent):
            if content["kind"] == "frame":
                widget._receive(widget, {"kind": "seen", "frame": content["number"]}, [])
        time.sleep(0.01)
    assert sent[0][0]["kind"] == "welcome"
    assert "text/html" in view._repr_mimebundle_() or view._repr_mimebundle_()
    view.close()
