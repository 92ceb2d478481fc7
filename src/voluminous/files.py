"""Files that are written completely or not at all, and errors that name the file."""

from __future__ import annotations

import difflib
import errno
import hashlib
import itertools
import math
import os
import platform
import re
import secrets
import shutil
import time
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from .errors import FileFormatError, InputError, VoluminousError, how_to_take

# How systems, and libraries that do not pass on their numbers, say that a disk is full.
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
# Names in a directory that are compared with a mistyped one, or looked at for changes.
_MOST = 10_000
# Seconds after which nobody is still writing.
_STALE = 3600.0
# Bytes for which there is space where a disk is not full.
_LITTLE = 1 << 20
# How often, and after which seconds, a directory is removed in which others still write.
_TRIES, _PAUSE = 10, 0.05
_URL = re.compile("(https?|s3|gs|gcs|az|abfs):/{1,2}")
_SPACE = re.compile("no space left|not enough space|quota exceeded|file too large", re.IGNORECASE)


def as_path(path: object) -> Path:
    """Return the path that a user gives."""
    if isinstance(path, (str, os.PathLike)):
        return Path(path)
    raise InputError(f"expected the path of a file, got {type(path).__name__}{how_to_take(path)}")


def check_readable(path: Path) -> None:
    """Refuse what is neither a file nor a directory: pipes are waited for, and devices endless."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(
            f"{path} is a pipe, a socket or a device, expected a file; copy what comes out of it "
            "into one"
        )


def url_of(path: Path) -> str:
    """Return the URL (http, https, s3, gs, az) that a path stands for; empty for a local path.

    Examples
    --------
    >>> url_of(Path("https://example.org/cells.zarr")), url_of(Path("data/cells.zarr"))
    ('https://example.org/cells.zarr', '')
    """
    found = _URL.match(path.as_posix())  # a path has lost one of the two slashes
    return f"{found[1]}://{path.as_posix()[found.end() :]}" if found else ""


def seen_from(directory: Path, path: str) -> Path:
    """Return a path taken relative to a directory, unless it is absolute or a URL."""
    expanded = Path(path).expanduser()
    return expanded if url_of(expanded) else directory / expanded


def stamp(path: Path) -> str:
    """Return what changes when a file does: its name, size and time; of a directory, of all in it.

    Of a directory of more than 10 000 files only those that come first, by their names, are looked
    at. A URL is its own stamp.
    """
    if url := url_of(path):
        return url
    files = itertools.chain([path], sorted(path.rglob("*")) if path.is_dir() else ())
    states = ((p.relative_to(path.parent), p.stat()) for p in itertools.islice(files, _MOST))
    stamped = [f"{p.as_posix()} {s.st_size} {s.st_mtime_ns}" for p, s in states]
    return (
        stamped[0] if len(stamped) == 1 else hashlib.sha256("\n".join(stamped).encode()).hexdigest()
    )


# What describes a Zarr store in a directory.
STORE_FILES = ("zarr.json", ".zarray", ".zgroup", ".zattrs", ".zmetadata")
# When what is being read was opened, in nanoseconds: see `check_age`.
_SINCE: ContextVar[float] = ContextVar("since", default=math.inf)
Opening = tuple[Path, int, list[str]]


def opening(path: Path) -> Opening:
    """Return the path, now, and stamps of the file, or of what describes a store in a directory."""
    if url_of(path):
        return path, 0, []
    files = [path / name for name in STORE_FILES] if path.is_dir() else [path]
    # The clock of a server may be ahead of that of this machine.
    near = itertools.islice(path.iterdir(), _MOST) if path.is_dir() else files
    newest = max((p.lstat().st_mtime_ns for p in near), default=0)
    return path, max(time.time_ns(), newest), [stamp(p) for p in files if p.is_file()]


@contextmanager
def unchanged(opened: Opening) -> Iterator[None]:
    """Refuse what is read of a file that was changed since it was opened, or while it is read."""
    path, since, stamps = opened

    def check() -> None:
        for stamped in stamps:
            file = path / stamped.split(" ")[0] if path.is_dir() else path
            if not file.is_file() or stamp(file) != stamped:
                raise _changed(file)

    token = _SINCE.set(since or math.inf)
    try:
        check()
        yield
    except Exception:
        check()  # which is why it could not be read
        raise
    finally:
        _SINCE.reset(token)
    check()


def check_age(path: Path) -> None:
    """Refuse what was read of a file that is newer than the opening of a store, or a header."""
    if _SINCE.get() < math.inf and path.stat().st_mtime_ns > _SINCE.get():
        raise _changed(path)


def _changed(path: Path) -> FileFormatError:
    what = "changed" if path.exists() else "moved or deleted"
    return FileFormatError(
        f"{path.name} was {what} since it was opened: open it again, once nothing writes to it"
    )


class UnwritablePathError(InputError, OSError):
    """A file that cannot be written where it shall be."""


class MissingPathError(InputError, FileNotFoundError):
    """A file or a directory that does not exist."""


def missing(path: Path) -> MissingPathError:
    """Return the error for a path that does not exist; names the nearest that does."""
    check_readable(path)
    parts = [path, *path.parents]
    first = next((k for k, part in enumerate(parts) if part.exists()), len(parts))
    if not 0 < first < len(parts):
        return MissingPathError(f"there is no file {path}")
    wrong, rest = parts[first - 1], parts[: first - 1]
    with suppress(OSError):
        names = {
            entry.name.lower(): entry.name
            for entry in itertools.islice(parts[first].iterdir(), _MOST)
        }
        for name in difflib.get_close_matches(wrong.name.lower(), names, n=3):
            near = parts[first] / names[name]
            for part in reversed(rest):
                near = near / part.name
            if near.exists():
                return MissingPathError(f"there is no file {path}; did you mean {near}?")
    reason = f": the directory {wrong} does not exist" if rest else ""
    return MissingPathError(f"there is no file {path}{reason}")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to, which replaces `path` at the end if there is no error.

    The temporary file is in the same directory, so the last step is one atomic rename: `path` is
    always either the old file or the complete new one. A symbolic link is followed, not replaced.
    """
    target = Path(os.path.realpath(path))
    with _beside(target) as temporary:
        with naming_unwritable(path):
            _check_place(path, target)
            temporary.touch()
            temporary.unlink()
        with _naming_if_full(path, temporary):
            yield temporary
        with naming_unwritable(path):
            if target.exists():
                shutil.copymode(target, temporary)
            os.replace(temporary, target)


@contextmanager
def new_directory(path: Path) -> Iterator[Path]:
    """Give a temporary directory to write to, which becomes `path` at the end; see `replacing`."""
    target = Path(os.path.realpath(path))
    with _beside(target) as temporary:
        _check_new(path, target)
        with naming_unwritable(path):
            temporary.mkdir()
        with _naming_if_full(path, temporary):
            yield temporary
        _check_new(path, target)  # others may have written it meanwhile
        with naming_unwritable(path):
            with suppress(OSError):
                target.rmdir()
            os.rename(temporary, target)


@contextmanager
def _beside(target: Path) -> Iterator[Path]:
    """Give a temporary name; at the end remove what has it, and what killed programs left."""
    remove_unfinished([target])
    word = f"{_this_machine()}-{os.getpid()}-{secrets.token_hex(6)}"
    temporary = target.with_name(_temporary_name(target, word))
    try:
        yield temporary
    finally:
        with suppress(OSError):
            _remove(temporary)


def _remove(path: Path) -> None:
    for _ in range(_TRIES):
        if not path.is_dir():
            path.unlink(missing_ok=True)
            return
        # Threads of a library may still be writing to it.
        shutil.rmtree(path, ignore_errors=True)
        time.sleep(_PAUSE)


def _temporary_name(target: Path, word: str) -> str:
    return f".{target.stem[:40]}.{word}.part{target.suffix}"


# A word of a temporary name: the machine, the process and a random number.
_TEMPORARY = re.compile(r"(\..*\.)([0-9a-f]{8})-(\d+)-[0-9a-f]{12}(\.part.*)", re.DOTALL)


def _this_machine() -> str:
    return f"{zlib.crc32(platform.node().encode()):08x}"


def remove_unfinished(paths: Iterable[Path]) -> None:
    """Remove what programs left that were killed while they wrote some files or directories.

    What a process may be writing at this moment is left alone: one that runs on this machine, or
    that of another which has written to a file in the last hour, or to a directory at any time.
    """
    import psutil

    targets = [Path(os.path.realpath(path)) for path in paths]
    ends = {(t.parent, *_temporary_name(t, "/").split("/")) for t in targets}
    for directory in {target.parent for target in targets}:
        for file in directory.glob(".*.part*"):
            found = _TEMPORARY.fullmatch(file.name)
            if found is None or (directory, found[1], found[4]) not in ends:
                continue
            with suppress(OSError):  # written meanwhile
                if found[2] == _this_machine():
                    dead = not psutil.pid_exists(int(found[3]))
                else:
                    dead = file.is_file() and time.time() - file.stat().st_mtime > _STALE
                if dead:
                    _remove(file)


@contextmanager
def _naming_if_full(path: Path, temporary: Path) -> Iterator[None]:
    try:
        yield
    except VoluminousError:
        raise
    except Exception as error:
        if _is_about_space(error) or _is_full(temporary):
            raise UnwritablePathError(
                f"cannot save {path}: there is no space left; make some, or give another directory"
            ) from error
        if isinstance(error, OSError) and str(error.filename).startswith(str(temporary)):
            with naming_unwritable(path):
                raise
        raise


def _is_about_space(error: BaseException | None) -> bool:
    while error is not None:  # the reason may be that of an error it came from
        if getattr(error, "errno", None) in _NO_SPACE or _SPACE.search(str(error)):
            return True
        error = error.__cause__ or error.__context__
    return False


def _is_full(temporary: Path) -> bool:
    """Return whether no more can be written where something has failed; not all libraries tell."""
    try:
        with open(temporary / "more" if temporary.is_dir() else temporary, "ab") as file:
            file.write(bytes(_LITTLE))
    except OSError as error:
        return error.errno in _NO_SPACE
    return False


@contextmanager
def naming_unwritable(path: Path) -> Iterator[None]:
    """Name the file or directory that cannot be written, and say what to do."""
    try:
        yield
    except VoluminousError:
        raise
    except OSError as error:
        raise UnwritablePathError(
            f"cannot save {path}: {error.strerror or error}; give another name or directory"
        ) from error


def make_directory(path: Path) -> None:
    """Make a directory, and those it is in, unless they are there."""
    with naming_unwritable(path):
        path.mkdir(parents=True, exist_ok=True)


def _check_new(path: Path, target: Path) -> None:
    with naming_unwritable(path):
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise InputError(f"{path} is there already; give a new name, or remove it first")
        check_parent(path, target)


def _check_place(path: Path, target: Path) -> None:
    if target.is_dir():
        raise InputError(f"{path} is a directory; give the name of a file in it")
    if target.exists() and not target.is_file():
        raise UnwritablePathError(
            f"cannot save {path}: it is a device, a pipe or a socket; give the name of a file"
        )
    check_parent(path, target)


def check_parent(path: Path, target: Path) -> None:
    """Check that a file or directory is to be made in one that is there."""
    if target.parent.exists() and not target.parent.is_dir():
        raise UnwritablePathError(
            f"cannot save {path}: {target.parent} is a file; give the name of a directory"
        )
    if not target.parent.is_dir():
        raise MissingPathError(
            f"cannot save {path}: the directory {target.parent} does not exist; create it first"
        )


def check_start(path: Path, magic: tuple[bytes, ...], expectation: str) -> None:
    """Check that a file exists, is not empty and starts with one of the `magic` bytes."""
    check_readable(path)
    try:
        with open(path, "rb") as file:
            start = file.read(max(len(m) for m in magic))
    except FileNotFoundError:
        raise missing(path) from None
    except IsADirectoryError:
        raise InputError(f"{path} is a directory; give the name of a file in it") from None
    if not start:
        raise FileFormatError(f"{path} is empty; expected {expectation}")
    if not start.startswith(magic):
        raise FileFormatError(f"{path} is not {expectation}: it starts with {start!r}")


@contextmanager
def expecting(path: Path, expectation: str) -> Iterator[None]:
    """Turn all errors of a library that reads `path` into one that names the file."""
    try:
        yield
    except ImportError:
        raise  # not the file's fault
    except VoluminousError as error:
        raise FileFormatError(f"{path}: {error}") from error
    except Exception as error:
        # A damaged file makes its library raise nearly anything, from KeyError to zlib.error.
        raise FileFormatError(
            f"{path}: expected {expectation}, but it is damaged or of another kind "
            f"({type(error).__name__}: {error})"
        ) from error
