"""Files on servers, through fsspec: patience with those that are slow, and errors in words."""

from __future__ import annotations

import asyncio
import functools
import gc
import io
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import UnreachableError
from ..files import url_of
from ..packages import require

# Seconds before a transfer that failed is tried again.
WAITS = (0.2, 1.0)
# Seconds until a server must be reached, and must send something.
CONNECT, SILENCE = 10, 30
# HTTP's numbers for servers that are busy; those of errors begin with 5.
_BUSY = (408, 425, 429)
_DENIED = (401, 403)
_CREDENTIALS = "NoCredentialsError"
_HOW_TO_SIGN_IN = (
    "credentials for s3 come from AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or from "
    "~/.aws/credentials; data that are public are read with FSSPEC_S3_ANON=true"
)
# Of a file on a server, so many bytes are read at a time, and so often are kept.
_BLOCK, _BLOCKS = 4 << 20, 8


def options(url: str) -> dict[str, Any]:
    """Return what fsspec is given beside a URL."""
    require("fsspec", "remote", f"opening {url}")
    if not url.startswith("http"):
        return {}
    aiohttp = require("aiohttp", "remote", f"opening {url}")
    from fsspec.config import conf

    patience = aiohttp.ClientTimeout(None, sock_connect=CONNECT, sock_read=SILENCE)
    given = conf.get(url.partition(":")[0], {}).get("client_kwargs", {})
    return {"client_kwargs": {"timeout": patience, **given}}


def may_pass(error: Exception) -> bool:
    """Return True for errors of a transfer that may not come again."""
    status = getattr(error, "status", None)
    if isinstance(status, int):
        return status >= 500 or status in _BUSY
    of_transfer = isinstance(error, (OSError, asyncio.TimeoutError))
    lasting = isinstance(error, (PermissionError, FileNotFoundError))
    return (of_transfer or _of_http(error)) and not lasting


def may_be_absent(error: Exception) -> bool:
    """Return True for what servers that list no files say of one that is not there."""
    return isinstance(error, PermissionError) or getattr(error, "status", None) == 403


def _of_http(error: Exception) -> bool:
    return type(error).__module__.startswith("aiohttp")


def in_words(key: str, error: Exception) -> Exception:
    """Return the error for a transfer that failed; any other is returned as it is."""
    said = f"{type(error).__name__}: {error}"[:400]
    denied = isinstance(error, PermissionError) or getattr(error, "status", None) in _DENIED
    if denied or type(error).__name__ == _CREDENTIALS:
        return UnreachableError(f"access to {key} is denied ({said}); {_HOW_TO_SIGN_IN}")
    if isinstance(error, ValueError) and "range" in str(error):
        return UnreachableError(
            f"{key}: the server gives whole files only, no ranges of bytes; copy the file, or "
            "convert it to Zarr"
        )
    if may_pass(error):
        tried = f"tried {1 + len(WAITS)} times"
        return UnreachableError(f"{key} cannot be read, {tried} ({said}); try later")
    return UnreachableError(f"{key} cannot be read ({said})") if _of_http(error) else error


class RemoteFile(io.RawIOBase):
    """A file on a server, any part of which can be read; the last error is kept.

    HDF5 says only that reading failed.
    """

    def __init__(self, url: str) -> None:
        from fsspec.core import url_to_fs

        system, path = url_to_fs(url, **options(url))
        self.url = url
        self.failed: Exception | None = None
        blocks = {"block_size": _BLOCK, "cache_options": {"maxblocks": _BLOCKS}}
        self.file: Any = self._tried(
            lambda: system.open(path, "rb", cache_type="blockcache", **blocks)
        )

    def _tried(self, transfer: Any) -> Any:
        for wait in (*WAITS, None):
            try:
                return transfer()
            except Exception as error:
                if wait is None or not may_pass(error):
                    self.failed = failed = in_words(self.url, error)
                    raise failed from error
            time.sleep(wait)
        return None

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return int(self.file.tell())

    def seek(self, offset: int, whence: int = 0) -> int:
        return int(self.file.seek(offset, whence))

    def readinto(self, buffer: Any) -> int:
        """Read into a buffer; return the number of bytes."""
        place, view = self.file.tell(), memoryview(buffer).cast("B")

        def transfer() -> bytes:
            self.file.seek(place)
            return bytes(self.file.read(len(view)))

        content = self._tried(transfer)
        view[: len(content)] = content
        return len(content)


@functools.lru_cache(_BLOCKS)
def file_at(url: str) -> RemoteFile:
    """Return the file at a URL; it stays open in this process."""
    return RemoteFile(url)


_ONE = threading.RLock()


@contextmanager
def for_hdf5(url: str) -> Iterator[RemoteFile]:
    """Give the file at a URL to HDF5, to one thread at a time, while no garbage is collected.

    HDF5 keeps its lock while it waits for bytes. A thread that brings these, and collects garbage
    of HDF5's meanwhile, would wait for that lock: for ever.
    """
    with _ONE:
        collects = gc.isenabled()
        gc.disable()
        try:
            yield file_at(url)
        finally:
            if collects:
                gc.enable()


def head_of(path: Path, length: int) -> bytes:
    """Return the first bytes of a file at a URL; none of a store, which is a directory."""
    try:
        file = file_at(url_of(path))
    except FileNotFoundError:
        return b""
    file.seek(0)
    return file.read(length) or b""
