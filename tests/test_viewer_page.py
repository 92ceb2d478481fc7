"""The explorer's server: who is let in, what is served, and a page that comes back."""

from __future__ import annotations

import base64
import contextlib
import gzip
import hashlib
import http.client
import io
import json
import os
import socket
import stat
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import voluminous as vm
from voluminous.cli import main
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


# What nginx and Apache pass on unless told otherwise, and what they do if they are.
@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:8080", "hub.example.org"])
@pytest.mark.parametrize(
    ("origin", "allowed"),
    [
        ("https://hub.example.org", True),
        ("http://hub.example.org", True),
        ("https://HUB.example.org:8443", True),
        ("http://[2001:db8::1]:8000", True),
        # Local names are hosts, but a page of another port is another's.
        ("http://localhost", False),
        ("http://localhost:9999", False),
        ("http://127.0.0.1:9999", False),
        ("http://[::1]:9999", False),
        ("ftp://hub.example.org", False),
        ("https://hub.example.org.evil.example", False),
        ("https://evil.example:443@hub.example.org", False),
        ("https://hub.example.org@evil.example", False),
        ("https://hub.example.org:443/", False),
        ("https://evil.example/hub.example.org", False),
        ("https://evil.example#://hub.example.org", False),
        ("https://hub.example.org\n", False),
        ("https://[hub.example.org]:x", False),
        ("hub.example.org", False),
        ("https://", False),
        ("null", False),
        ("", False),
    ],
)
def test_pages_of_a_name_that_a_proxy_has_are_let_in(host, origin, allowed):
    guard = Guard(["Hub.example.org", "[2001:db8::1]"])
    protocols = [SUBPROTOCOL, f"token.{guard.token}"]
    assert guard.knows_host(host)
    assert guard.lets_in(host, origin, protocols) is allowed
    assert not guard.lets_in(host, origin, [SUBPROTOCOL, "token.wrong"])
    assert not guard.lets_in("evil.example", origin, protocols)
    assert not Guard().knows_origin("https://hub.example.org", "127.0.0.1:8080")


@pytest.fixture(scope="module", params=["/volume/", "/user/ada%40example.org/volume"])
def prefixed(request):
    explorer = Explorer(VOLUME, MEDIUM, CAMERA)
    server = Server(explorer, base_path=request.param, hosts=["hub.example.org"])
    server.start()
    yield server, request.param.rstrip("/")
    server.close()
    explorer.close()


def test_a_proxy_may_keep_or_strip_its_prefix(prefixed):
    server, base = prefixed
    assert server.url.startswith(f"http://127.0.0.1:{server.port}{base}/#token=")
    for prefix in ("", base):
        for path in _FILES:
            assert get(server, prefix + path)[0] == 200
        with connect(server, origin="https://hub.example.org", path=f"{prefix}/ws") as page:
            page.send("3")
            assert json.loads(page.recv(timeout=10))["kind"] == "notice"
    for path in (f"{base}/ws", f"{base}{base}/", f"{base}{base}", f"{base}s/", f"{base}/../"):
        assert get(server, path)[0] == 404
    for path in (base, f"{base}{base}/ws", f"{base}s/ws", f"{base}ws", f"{base}/ws/"):
        with pytest.raises(exceptions.InvalidStatus) as error:
            connect(server, path=path)
        assert error.value.response.status_code in (403, 404)


def test_the_prefix_without_its_slash_leads_to_the_page(prefixed):
    server, base = prefixed
    for query in ("", "?follow", "?follow&a=%0d%0ab"):
        status, headers, _ = get(server, base + query)
        assert (status, headers["location"]) == (307, f"{base}/{query}")
    assert get(server, base, Host="evil.example")[0] == 403
    assert get(server, base, "POST")[0] == 405


@pytest.mark.parametrize("path", ["/", ""])
def test_without_a_prefix_all_is_as_it_was(server, path):
    unserved = Server(server.explorer, base_path=path)
    assert unserved.url.startswith(f"http://127.0.0.1:{unserved.port}/#token=")
    unserved._socket.close()


@pytest.mark.parametrize(
    "path",
    [
        "volume",
        "//",
        "//evil.example/",
        "/a//b",
        "/../",
        "/a/./b",
        "/a/%2e%2e/",
        "/a b",
        "/a?b",
        "/a#b",
        "/a%",
        "/a%0d%0ab",
        "/a\n",
        "\\a",
        "https://hub.example.org/volume/",
    ],
)
def test_strange_prefixes_are_refused(server, path):
    with pytest.raises(vm.InputError, match="/volume/"):
        Server(server.explorer, base_path=path)


def test_the_command_serves_under_the_prefix(tmp_path, monkeypatch, capsys):
    vm.models.prestellar_core(8).save(tmp_path / "a.npz")
    monkeypatch.setattr(Server, "wait", lambda self, seconds=None: True)
    file = str(tmp_path / "a.npz")
    assert main(["view", file, "--no-browser", "--base-path", "/volume/"]) == 0
    assert "/volume/#token=" in capsys.readouterr().out
    assert main(["view", file, "--no-browser", "--base-path", "volume"]) != 0
    assert "/volume/" in capsys.readouterr().err


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
    assert size <= 70 << 10


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

        def send_and_listen():  # it ends before all is sent, or behind
            page.send("x" * (2 << 20))
            return list(iter(page.recv, None))

        with pytest.raises(exceptions.ConnectionClosed):
            send_and_listen()
    with connect(server) as page:
        for data in (b"bytes", b"", b'{"kind": "visible", "on": true}', '{"kind": "seen", "n": 1}'):
            page.send(data)
            assert json.loads(page.recv(timeout=10))["level"] == "error"


@pytest.mark.parametrize(
    "text",
    [
        '{"kind": "look", "n": 1e400, "camera": {}}',
        '{"kind": "look", "n": 1, "camera": {"type": "orthographic", "incl": -1e400}}',
        '{"kind": "size", "n": 1, "size": [NaN, 5]}',
        f'{{"kind": "size", "n": 1, "size": [1{"0" * 400}, 5]}}',
        '{"kind": "set", "n": 1, "patch": [["bookmarks", [Infinity]]]}',
        '{"kind": "undo", "n": 1e400}',
        '{"kind": "seen", "frame": 1e400}',
        '{"kind": "time", "n": 1, "index": 1e400}',
        '{"kind": "histogram", "id": 1e400, "expr": "a"}',
        '{"kind": "hello", "protocol": 1, "size": [1e400, 5]}',
    ],
)
def test_numbers_that_are_too_large_end_no_connection(server, text):
    with connect(server) as page:
        page.send(text)
        # As a browser's JSON, which has neither infinities nor NaN.
        notice = json.loads(page.recv(timeout=10), parse_constant=pytest.fail)
        assert (notice["kind"], notice["level"]) == ("notice", "error")
        page.send(json.dumps({"kind": "histogram", "id": 7, "expr": "a"}))
        while (answer := json.loads(page.recv(timeout=10))).get("id") != 7:
            assert answer["kind"] == "document"
        assert answer["counts"]


def test_a_page_is_heard_while_another_sends_more_than_can_be_done(server, monkeypatch):
    from voluminous.viewer import explorer

    go_on, count = threading.Event(), 600
    made_of = explorer.build_medium

    def slowly(tables):
        assert go_on.wait(60)
        return made_of(tables)

    monkeypatch.setattr(explorer, "build_medium", slowly)
    question = json.dumps({"kind": "histogram", "id": 7, "expr": "a"})
    with connect(server) as busy, connect(server) as other:
        for n in range(1, count + 1):
            patch = [["image.exposure", 1.0 + n]]
            busy.send(json.dumps({"kind": "set", "n": n, "patch": patch, "label": "exposure"}))
        camera = {"type": "orthographic", "incl": 12, "phi": 7}
        busy.send(json.dumps({"kind": "look", "n": count + 1, "camera": camera}))
        busy.send(question)
        other.send(question)
        assert json.loads(other.recv(timeout=60))["id"] == 7
        refused = set()
        while (message := json.loads(busy.recv(timeout=60)))["kind"] == "notice":
            refused.add(message["n"])
        assert message["id"] == 7
        go_on.set()
        # One document was being made, and another one holds all that has come since.
        told = [json.loads(busy.recv(timeout=60)) for _ in range(2)]
    assert [message["kind"] for message in told] == ["document"] * 2
    assert told[1]["n"] == count + 1
    assert count + 1 in refused
    assert told[1]["document"]["camera"] == told[0]["document"]["camera"]
    # Each input is in the document or refused, and the page was told so.
    made = set(range(1, count + 1)) - refused
    assert 240 <= len(made) < count
    assert told[1]["document"]["image"]["exposure"] == 1.0 + max(made)


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


@pytest.fixture
def session(tmp_path, monkeypatch):
    """Return the folder where the tokens of a user's session are."""
    monkeypatch.delenv("VOLUMINOUS_TOKEN", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / f"voluminous-{os.getuid()}"


def test_a_rerun_on_the_same_port_has_the_same_token(session, server):
    with contextlib.closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    urls = []
    for _ in range(2):
        again = Server(server.explorer, port=port)
        again._socket.close()
        urls.append(again.url)
    assert urls[0] == urls[1]
    file = session / f"port-{port}"
    assert stat.S_IMODE(session.stat().st_mode) == 0o700
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert urls[0].endswith(f"#token={file.read_text()}")
    assert Guard(port=port + 1).token != Guard(port=port).token
    assert Guard().token != Guard().token  # of any free port, and of a socket
    assert {path.name for path in session.iterdir()} == {f"port-{port}", f"port-{port + 1}"}


def _is_readable(file):
    file.chmod(0o640)


def _is_old(file):
    os.utime(file, (time.time() - 90_000,) * 2)


def _is_a_link(file):
    file.rename(file.with_name("other"))
    file.symlink_to(file.with_name("other"))


def _is_empty(file):
    file.write_text("")


def _is_a_pipe(file):
    file.unlink()
    os.mkfifo(file, 0o600)


@pytest.mark.parametrize("spoil", [_is_readable, _is_old, _is_a_link, _is_empty, _is_a_pipe])
def test_a_token_that_others_may_know_is_made_anew(session, spoil):
    first = Guard(port=8080).token
    spoil(session / "port-8080")
    with pytest.warns(UserWarning, match="port-8080.*made anew"):
        second = Guard(port=8080).token
    assert second != first
    assert Guard(port=8080).token == second
    assert stat.S_IMODE((session / "port-8080").lstat().st_mode) == 0o600


def test_a_folder_that_others_can_open_gives_no_token(session, monkeypatch):
    first = Guard(port=8080).token
    session.chmod(0o755)
    with pytest.warns(UserWarning, match="other users can open it"):
        assert Guard(port=8080).token != first
    session.chmod(0o700)
    user = os.getuid()
    with monkeypatch.context() as other:
        other.setattr(os, "getuid", lambda: user + 1)
        (session.parent / f"voluminous-{user + 1}").mkdir(0o700)
        with pytest.warns(UserWarning, match="not yours"):
            assert Guard(port=8080).token != first
    assert Guard(port=8080).token == first


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
    shown, _ = view._repr_mimebundle_()
    assert any("widget-view" in kind for kind in shown)
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(shown["image/png"]))))
    assert picture.max() > 100  # what a saved notebook shows
    view.close()


def test_a_page_that_comes_early_waits_for_the_explorer(server):
    early = Server(name="large.npy")
    early.start()
    with connect(early) as page:
        assert json.loads(page.recv(10)) == {"kind": "opening", "name": "large.npy"}
        page.send(json.dumps({"kind": "hello", "protocol": 1, "size": [8, 8], "scale": 1}))
        with pytest.raises(TimeoutError):
            page.recv(0.2)
        early.show(server.explorer)
        assert json.loads(page.recv(10))["kind"] == "welcome"
    early.close()


def test_a_page_is_told_why_there_is_nothing_to_see():
    early = Server()
    early.start()
    with connect(early) as page:
        page.recv(10)
        early.refuse(vm.InputError("a.npy is cut short"), 10.0)
        notice = json.loads(page.recv(10))
        assert (notice["level"], notice["text"]) == ("error", "a.npy is cut short")
        with pytest.raises(exceptions.ConnectionClosed):
            page.recv(10)
    early.close()
