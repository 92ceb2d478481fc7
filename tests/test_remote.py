"""Stores on servers: read in pieces, opened once, tried again; errors in words."""

from __future__ import annotations

import asyncio
import functools
import logging
import pickle
import secrets
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import h5py
import numpy as np
import pytest

import voluminous as vm
from voluminous.errors import UnreachableError
from voluminous.io.registry import open_lazily
from voluminous.io.remote import file_at

pytest.importorskip("zarr", "3")
fsspec = pytest.importorskip("fsspec")

RHO = np.random.default_rng(8).random((12, 8, 6), np.float32)
VOLUME = vm.Volume(vm.CartesianGrid.uniform(RHO.shape, (-1, 1), unit="pc"), rho=RHO)
MEDIUM = vm.Gaussian("rho", 0.5, 0.1, "orange", opacity=0.5, path_length="1 pc")
CAMERA = vm.Orthographic(60, 30, width="4 pc", resolution=16)


class Server:
    """Serves a directory; notes what is asked for, and fails as told."""

    def __init__(self, directory):
        self.asked, self.failures, self.status = [], 0, 503
        outer = self

        class Handler(SimpleHTTPRequestHandler):
            def log_message(self, *_):
                pass

            def do_GET(self):
                outer.asked.append(self.path)
                if outer.failures:
                    outer.failures -= 1
                    self.send_error(outer.status)
                elif "Range" in self.headers:
                    self.send_range()
                else:
                    super().do_GET()

            def send_range(self):
                content = Path(self.translate_path(self.path)).read_bytes()
                first, last = self.headers["Range"].removeprefix("bytes=").split("-")
                part = content[int(first) : int(last or len(content)) + 1]
                self.send_response(206)
                self.send_header("Content-Range", f"bytes {first}-{last}/{len(content)}")
                self.send_header("Content-Length", str(len(part)))
                self.end_headers()
                self.wfile.write(part)

        handler = functools.partial(Handler, directory=str(directory))
        self.server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        Thread(target=self.server.serve_forever, daemon=True).start()
        self.url = f"http://127.0.0.1:{self.server.server_port}"


@pytest.fixture
def at_once(monkeypatch):
    """Let no time pass before a transfer that failed is tried again."""
    sleep = asyncio.sleep
    monkeypatch.setattr(asyncio, "sleep", lambda seconds: sleep(0))
    monkeypatch.setattr(time, "sleep", lambda seconds: None)


@pytest.fixture
def server(tmp_path, at_once):
    pytest.importorskip("aiohttp")
    VOLUME.save(tmp_path / "a.zarr", chunks=4, levels=True, stats=True)
    served = Server(tmp_path)
    yield served
    served.server.shutdown()


def test_a_picture_over_http_reads_each_chunk_once(server):
    volume = open_lazily(f"{server.url}/a.zarr")
    # The root tells of all arrays.
    assert not [path for path in server.asked if "/fields" in path or "levels" in path]
    server.asked.clear()
    image = vm.render(volume, MEDIUM, CAMERA, scheme="first-order", memory="1 GiB")
    assert volume.waiting == ("rho",)
    whole = vm.render(VOLUME, MEDIUM, CAMERA, scheme="first-order")
    np.testing.assert_array_equal(image.intensity, whole.intensity)
    assert len(server.asked) == len(set(server.asked)) <= 1 + 3 * 2 * 2
    assert not [path for path in server.asked if "json" in path]
    other = pickle.loads(pickle.dumps(volume))
    np.testing.assert_array_equal(other.store.read("rho", (3, 1, 2), (9, 8, 6)), RHO[3:9, 1:, 2:])
    assert other.store.shape(1) == (6, 4, 3)


@pytest.mark.parametrize("status", [500, 503, 429])
def test_what_fails_is_tried_again(server, status):
    store = open_lazily(f"{server.url}/a.zarr").store
    store.extremes("rho")
    server.failures, server.status = 2, status
    np.testing.assert_array_equal(store.read("rho", (0, 0, 0), (4, 4, 4)), RHO[:4, :4, :4])
    server.asked.clear()
    server.failures = 1000
    where = rf"{server.url}/a\.zarr: /fields/rho\[.*fields/rho/c/1/0/0 cannot be read, tried 3 "
    with pytest.raises(UnreachableError, match=where) as failure:
        store.read("rho", (4, 0, 0), (8, 4, 4))
    assert len(server.asked) == 3
    # Tasks of an executor are tried again for such errors.
    assert isinstance(failure.value, OSError)
    with pytest.raises(UnreachableError, match=rf"{server.url}/a\.zarr: \S+ cannot be read"):
        vm.open(f"{server.url}/a.zarr")


@pytest.mark.parametrize(
    ("status", "message"), [(403, "access to .* is denied"), (401, "is denied"), (400, "cannot be")]
)
def test_what_is_refused_is_not_tried_again(server, status, message):
    server.failures, server.status = 1000, status
    with pytest.raises(UnreachableError, match=message):
        vm.open(f"{server.url}/a.zarr")
    assert len(server.asked) <= 6


def test_what_is_not_there(server):
    with pytest.raises(vm.FileFormatError, match=rf"{server.url}/b\.zarr: there is no Zarr store"):
        vm.open(f"{server.url}/b.zarr")
    server.server.shutdown()
    server.server.server_close()
    with pytest.raises(UnreachableError, match=r"tried 3 times \(ClientConnectorError"):
        vm.open(f"{server.url}/a.zarr")


def test_a_silent_server(server, monkeypatch):
    aiohttp = pytest.importorskip("aiohttp")
    patience = aiohttp.ClientTimeout(None, sock_connect=0.1, sock_read=0.1)
    monkeypatch.setitem(fsspec.config.conf, "http", {"client_kwargs": {"timeout": patience}})
    silent = ThreadingHTTPServer(("127.0.0.1", 0), SimpleHTTPRequestHandler)
    # It takes connections, and never answers.
    with pytest.raises(UnreachableError, match="Timeout"):
        vm.open(f"http://127.0.0.1:{silent.server_port}/a.zarr")
    silent.server_close()


def test_a_lost_chunk_is_missed_over_http(server, tmp_path):
    volume = open_lazily(f"{server.url}/a.zarr")
    (tmp_path / "a.zarr/fields/rho/c/0/1/0").unlink()
    with pytest.raises(vm.FileFormatError, match=r"http.*missing .*level 0, chunk \(0, 1, 0\)"):
        vm.render(volume, MEDIUM, CAMERA, memory="1 GiB")


def test_a_store_that_was_written_anew_is_opened_anew(server, tmp_path):
    vm.open(f"{server.url}/a.zarr")
    (tmp_path / "a.zarr").rename(tmp_path / "old.zarr")
    vm.models.sphere(4).save(tmp_path / "a.zarr")
    assert vm.open(f"{server.url}/a.zarr").grid.shape == (4, 4, 4)


@pytest.fixture
def bucket(tmp_path, monkeypatch):
    """Serve a volume as S3 does."""
    pytest.importorskip("s3fs")
    moto = pytest.importorskip("moto.server")
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = moto.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    settings = {"ACCESS_KEY_ID": "a", "SECRET_ACCESS_KEY": "b", "DEFAULT_REGION": "us-east-1"}
    settings |= {"ENDPOINT_URL": f"http://{host}:{port}", "EC2_METADATA_DISABLED": "true"}
    for name, value in settings.items():
        monkeypatch.setenv(f"AWS_{name}", value)
    VOLUME.save(tmp_path / "a.zarr", chunks=4, stats=True)
    system = fsspec.filesystem("s3", s3_additional_kwargs={"ACL": "public-read"})
    # Buckets outlive the server.
    name = f"bucket-{secrets.token_hex(4)}"
    system.mkdir(name)
    system.put(str(tmp_path / "a.zarr"), f"{name}/a.zarr", recursive=True)
    type(system).clear_instance_cache()
    yield f"s3://{name}"
    type(system).clear_instance_cache()
    server.stop()


def test_a_picture_from_s3(bucket):
    volume = open_lazily(f"{bucket}/a.zarr")
    image = vm.render(volume, MEDIUM, CAMERA, scheme="first-order", memory="1 GiB")
    assert volume.waiting == ("rho",)
    whole = vm.render(VOLUME, MEDIUM, CAMERA, scheme="first-order")
    np.testing.assert_array_equal(image.intensity, whole.intensity)
    with pytest.raises(vm.FileFormatError, match=rf"{bucket}/b\.zarr: there is no Zarr store"):
        vm.open(f"{bucket}/b.zarr")


def test_without_credentials(bucket, monkeypatch):
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", "/nothing")
    with pytest.raises(UnreachableError, match=r"is denied .*NoCredentialsError.*FSSPEC_S3_ANON"):
        vm.open(f"{bucket}/a.zarr")
    monkeypatch.setenv("FSSPEC_S3_ANON", "true")
    monkeypatch.setattr("fsspec.config.conf", {})
    fsspec.config.set_conf_env(fsspec.config.conf)
    np.testing.assert_array_equal(vm.open(f"{bucket}/a.zarr").array("rho"), RHO)


@pytest.mark.parametrize("name", ["plain.h5", "packed.h5", "own.h5", "own_packed.h5", "rho.nc"])
def test_hdf5_over_http(server, tmp_path, name):
    """By the bytes that are asked for, from a server that gives parts of files."""
    values = np.random.default_rng(3).random((160, 130, 120), np.float32)  # 9.5 MiB
    large = vm.Volume(vm.CartesianGrid.uniform(values.shape, (-1, 1), unit="pc"), rho=values)
    options = {}
    if name == "rho.nc":
        xr = pytest.importorskip("xarray")
        pytest.importorskip("h5netcdf")
        lines = {a: np.arange(n) for a, n in zip("xyz", values.shape, strict=True)}
        xr.Dataset({"rho": (tuple("xyz"), values)}, lines).to_netcdf(
            tmp_path / name, engine="h5netcdf"
        )
    elif name.startswith("own"):
        large.save(tmp_path / name, compress="packed" in name)
    else:
        packed = {"chunks": (40, 40, 40), "compression": "gzip"} if name == "packed.h5" else {}
        with h5py.File(tmp_path / name, "w") as file:
            file.create_dataset("rho", data=values, **packed)
        options = {"bounds": (-1, 1), "unit": "pc"}
    file_at.cache_clear()
    volume = open_lazily(f"{server.url}/{name}", **options).unread()
    assert volume.waiting == ("rho",)
    box, part = ((40, 11, 2), (90, 130, 6)), values[40:90, 11:, 2:6]
    np.testing.assert_array_equal(volume.store.read("rho", *box), part)
    np.testing.assert_array_equal(vm.open(f"{server.url}/{name}", **options).array("rho"), values)
    if name == "own.h5":
        image = vm.render(volume, MEDIUM, CAMERA, scheme="first-order", memory="1 GiB")
        whole = vm.render(large, MEDIUM, CAMERA, scheme="first-order")
        np.testing.assert_array_equal(image.intensity, whole.intensity)
    file_at.cache_clear()
    server.failures = 2
    np.testing.assert_array_equal(volume.store.read("rho", *box), part)
    file_at.cache_clear()
    server.failures = 1000
    with pytest.raises(UnreachableError, match=rf"{name}: .*cannot be read, tried 3 times"):
        volume.store.read("rho", *box)


def test_tasks_are_tried_again(server):
    """Where a server fails longer than a reader waits, the task of an executor comes back."""
    volume = open_lazily(f"{server.url}/a.zarr")
    volume.store.extremes("rho")
    server.failures = 4
    with ThreadPoolExecutor(1) as pool:
        image = vm.render(
            volume, MEDIUM, CAMERA, scheme="first-order", memory="1 GiB", executor=pool
        )
    assert server.failures == 0
    assert max(Counter(server.asked).values()) == 5  # a reader tries three times
    whole = vm.render(VOLUME, MEDIUM, CAMERA, scheme="first-order")
    np.testing.assert_array_equal(image.intensity, whole.intensity)


class Reticent(Server):
    """Says "forbidden" of what is not there, as S3 does to those who may not list a bucket."""

    def __init__(self, directory):
        super().__init__(directory)
        handler, outer = self.server.RequestHandlerClass.func, self
        self.closed = False

        def do_get(request):
            outer.asked.append(request.path)
            if outer.closed or not Path(request.translate_path(request.path)).is_file():
                return request.send_error(403)
            return SimpleHTTPRequestHandler.do_GET(request)

        handler.do_GET = do_get


@pytest.mark.parametrize("form", [2, 3])
def test_what_a_server_forbids_may_be_what_is_not_there(tmp_path, at_once, form):
    import zarr

    pytest.importorskip("aiohttp")
    VOLUME.save(tmp_path / "own.zarr", chunks=4)
    foreign = zarr.create_array(
        tmp_path / "foreign.zarr",
        shape=RHO.shape,
        chunks=(4, 4, 3),
        dtype="f4",
        zarr_format=form,
        fill_value=-1.0,
    )
    foreign[:8] = RHO[:8]  # chunks that were never written are not there
    zarr.open_group(tmp_path / "group.zarr", mode="w", zarr_format=form).create_array(
        "rho", shape=(2, 2, 2), dtype="f4"
    )
    served = Reticent(tmp_path)
    np.testing.assert_array_equal(vm.open(f"{served.url}/own.zarr").array("rho"), RHO)
    with pytest.warns(UserWarning, match=r"there is no chunk .*denied.*fill value -1"):
        found = vm.open(f"{served.url}/foreign.zarr").array("foreign")
    np.testing.assert_array_equal(found[:8], RHO[:8])
    assert (found[8:] == -1).all()
    with pytest.raises(UnreachableError, match="does not list"):
        vm.open(f"{served.url}/group.zarr")
    served.closed = True
    for name in ("own", "foreign", "nothing"):
        with pytest.raises(UnreachableError, match=r"access to .* is denied"):
            vm.open(f"{served.url}/{name}.zarr")
    served.server.shutdown()
