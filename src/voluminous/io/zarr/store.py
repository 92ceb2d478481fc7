"""Zarr stores of versions 2 and 3, opened by the library: directories, ZIP files and URLs."""

from __future__ import annotations

import asyncio
import functools
import itertools
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ...errors import FileFormatError, UnreachableError, VoluminousError
from ...files import STORE_FILES, check_age, check_readable, url_of
from ...memory import check_memory
from ...packages import require
from .. import remote
from ..guard import by_library, placed
from ..hdf5 import is_hdf5
from ..payload import ZIP, zip_names

if TYPE_CHECKING:
    import zarr

_NODES = ("zarr.json", ".zarray", ".zgroup")
_DEEPEST = 16
# Descriptions of groups and arrays that are kept: reading them takes longer than reading a box.
_KEPT = 256


def holds_zarr(path: Path, head: bytes) -> bool:
    """Return True for a directory or a ZIP file that is a Zarr store, and for any such URL."""
    if url_of(path):
        return not is_hdf5(head)
    if path.is_dir():
        return any((path / name).is_file() for name in _NODES)
    if not head.startswith(ZIP):
        return False
    names = zip_names(path)
    return not names.isdisjoint(_NODES) or (not names and path.name.lower().endswith(".zarr.zip"))


@contextmanager
def opened(path: Path, place: str = "") -> Iterator[Any]:
    """Yield the root of a store, or what is at a place; errors become a `FileFormatError`.

    It is opened once per process, except for ZIP files: as long as its description in a directory
    is the same, or until a URL is opened by the user again (`forget`).
    """
    library = require("zarr", "arrays", "reading Zarr")
    url = url_of(path)
    with by_library("zarr"):
        if not url and path.is_file():
            archive = library.storage.ZipStore(path, mode="r")
            try:
                root = _open(archive)
                yield root[place] if place else root
            finally:
                archive.close()
        else:
            text = url or str(path.absolute())
            yield _node(text, place, () if url else (_stamp(path), _stamp(path / place)))


def _stamp(place: Path) -> tuple[Any, ...]:
    found = []
    for name in _NODES:
        try:
            status = (place / name).stat()
        except OSError:
            continue
        found.append((name, status.st_ino, status.st_mtime_ns, status.st_size))
    return tuple(found)


@functools.lru_cache(_KEPT)
def _node(text: str, place: str, stamp: tuple[Any, ...]) -> Any:
    if place:
        return checked(_node(text, "", stamp and (stamp[0], stamp[0]))[place])
    from zarr.storage import FsspecStore, LocalStore

    url = url_of(Path(text))
    if not url:
        return _open(LocalStore(text, read_only=True))
    return _open(FsspecStore.from_url(url, remote.options(url), read_only=True))


def forget() -> None:
    """Open stores anew: one at a URL may be another by now."""
    _node.cache_clear()


def _open(store: Any) -> Any:
    import zarr

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of files that are no part of the hierarchy
        careful = _careful()(store)
        try:
            return zarr.open(careful, mode="r")
        except FileNotFoundError:
            if careful.denied:  # all that could say what the store holds
                raise next(iter(careful.denied.values())) from None
            names = ", ".join(_NODES)
            raise FileFormatError(
                f"there is no Zarr store here, which has one of {names}"
            ) from None


@functools.cache
def _careful() -> type:
    from zarr.storage import FsspecStore, LocalStore, WrapperStore

    class CarefulStore(WrapperStore[Any]):
        def __init__(self, store: Any) -> None:
            super().__init__(store)
            self.absent: set[str] = set()
            self.denied: dict[str, Exception] = {}  # what counts as absent, too
            self.arrays: dict[str, Any] = {}  # that were opened, by their places
            self.warned: set[str] = set()  # those of which it was said that chunks are missing
            self.kept: dict[Any, Any] = {}  # what readers made of it

        async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
            if isinstance(self._store, LocalStore):
                check_readable(self._store.root / key)
            for wait in (*remote.WAITS, None):
                value = None
                if key in self.denied:
                    break
                try:
                    value = await self._store.get(key, prototype, byte_range)
                    break
                except Exception as error:
                    if isinstance(self._store, FsspecStore) and remote.may_be_absent(error):
                        self.denied[key] = remote.in_words(key, error)
                        break
                    if wait is None or not remote.may_pass(error):
                        raise remote.in_words(key, error) from error
                await asyncio.sleep(wait)
            (self.absent.add if value is None else self.absent.discard)(key)
            if value is not None and isinstance(self._store, LocalStore):
                check_age(self._store.root / key)
            if value is not None and byte_range is None and _by_blosc(self.owner(key)):
                _check_length(key, value)
            return value

        def owner(self, key: str) -> Any:
            """Return the array that a key is a chunk of; None if it is none, or not opened."""
            *place, name = key.split("/")
            places = ("/".join(place[:n]) for n in range(len(place), -1, -1))
            arrays = (self.arrays[p] for p in places if p in self.arrays)
            return None if name in STORE_FILES else next(arrays, None)

    return CarefulStore


def _by_blosc(array: Any) -> bool:
    if array is None or array.metadata.zarr_format == 2:
        packed = None if array is None else array.metadata.compressor
        return getattr(packed, "codec_id", "") == "blosc"
    return type(array.metadata.codecs[-1]).__name__ == "BloscCodec"


def _check_length(key: str, chunk: Any) -> None:
    """Refuse a chunk that is cut short: Blosc would read beyond its end.

    Its length is a number of four bytes in the head:
    https://github.com/Blosc/c-blosc/blob/main/README_CHUNK_FORMAT.rst.
    """
    head = chunk[:16].to_bytes()
    expected = int.from_bytes(head[12:16], "little")
    if len(head) < 16 or len(chunk) < expected:
        raise FileFormatError(f"{key} is cut short: it has {len(chunk)} bytes of {expected}")


def root_fits(path: Path, head: bytes, fits: Callable[[Any], bool]) -> bool | None:
    """Return whether a file is a Zarr store whose root fits; None if that cannot be opened.

    The reader of plain arrays then says what is wrong.
    """
    if not holds_zarr(path, head):
        return False
    try:
        with opened(path) as root:
            return fits(root)
    except UnreachableError as error:
        raise UnreachableError(f"{url_of(path) or path}: {error}") from error
    except VoluminousError:
        return None


def part(path: Path, place: str, index: Any = ..., *, complete: bool = False) -> np.ndarray:
    """Return a part of an array; errors name the array and the cells.

    Parameters
    ----------
    index : tuple of slices and int, or ...
        One for each axis of the array.
    complete : bool
        True if all chunks must be there. Zarr takes the fill value for those that are not, which
        many programs leave out on purpose; then a warning names the first.
    """
    with opened(path, place) as array:
        index = (slice(None),) * len(array.shape) if index is ... else index
        cells = ", ".join(
            str(i) if isinstance(i, int) else "{}:{}".format(*i.indices(n))
            for i, n in zip(index, array.shape, strict=True)
        )
        with placed(f"/{place}[{cells}]"), by_library("zarr"):
            values = _one_chunk(array, index)
            values = np.asarray(array[index]) if values is None else values
            lost = _lost(array, index)
            if lost is not None and complete:
                raise FileFormatError(f"the chunk {lost} is missing")
        warn_of_missing(path, array.store)
        return values


def _one_chunk(array: zarr.Array[Any], index: Sequence[Any]) -> np.ndarray | None:
    """Return a whole chunk of a store that `Volume.save` writes; None if that is not asked for.

    Zarr's pipeline of coroutines and copies takes 1.4 times as long (128³, single precision).
    """
    from zarr.storage import LocalStore

    files = cast(Any, array.store)._store if isinstance(array.store, _careful()) else None
    if array.metadata.zarr_format == 2 or array.shards or not isinstance(files, LocalStore):
        return None
    codecs = [type(codec).__name__ for codec in array.metadata.codecs]
    little = array.dtype == array.dtype.newbyteorder("<")
    if codecs != ["BytesCodec", "BloscCodec", "Crc32cCodec"] or not little:
        return None
    number = []
    for one, n, side in zip(index, array.shape, array.chunks, strict=True):
        low, high, step = (0, 0, 1) if isinstance(one, int) else one.indices(n)
        if low % side or high - low != side or step != 1:
            return None
        number.append(low // side)
    key = array.metadata.encode_chunk_key(tuple(number))
    import google_crc32c
    from numcodecs import blosc

    file = files.root / array.path / key
    check_readable(file)
    try:
        packed = file.read_bytes()
    except OSError:
        return None  # which is said, or tried again, where Zarr reads it
    check_age(file)
    # A view of bytes as NumPy's is the only one of which no copy is made.
    data = np.frombuffer(packed, np.uint8)
    if google_crc32c.value(data[:-4]) != int.from_bytes(packed[-4:], "little"):
        return None
    values = np.empty(array.chunks, array.dtype)
    blosc.decompress(data[:-4], values)
    return values


def warn_of_missing(path: Path, store: Any) -> None:
    """Warn of chunks that were not there; once per array."""
    for key in sorted(store.absent):
        array = store.owner(key)
        if array is not None and array.path not in store.warned:
            store.warned.add(array.path)
            denied = " (or access to it is denied)" if key in store.denied else ""
            warnings.warn(
                f"{url_of(path) or path}: there is no chunk {key}{denied}: Zarr takes the fill "
                f"value {array.fill_value} for its cells; others may be missing, too",
                stacklevel=3,
            )


def _lost(array: zarr.Array[Any], index: Sequence[Any]) -> tuple[int, ...] | None:
    store: Any = array.store
    if not store.absent:
        return None
    ranges = []
    sides = array.shards or array.chunks
    for one, n, side in zip(index, array.shape, sides, strict=True):
        low, high = (one, one + 1) if isinstance(one, int) else one.indices(n)[:2]
        ranges.append(range(low // side, -(-high // side)))
    start = f"{array.path}/" if array.path else ""
    for number in itertools.product(*ranges):
        if start + array.metadata.encode_chunk_key(number) in store.absent:
            return number
    return None


def arrays_in(node: Any, place: str = "") -> dict[str, zarr.Array[Any]]:
    """Return the arrays at a place and below it; that of a lone array is the empty string."""
    node = node[place] if place else node
    if not hasattr(node, "members"):
        return {place: checked(node)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of files that are no part of the hierarchy
        try:
            found = dict(node.members(max_depth=_DEEPEST))
        except Exception as error:
            if not remote.may_be_absent(error):
                raise
            raise UnreachableError(
                "the server does not list what is in the store, nor has it consolidated metadata, "
                "as zarr.consolidate_metadata writes them"
            ) from error
    ordered = sorted(found, key=lambda name: name.split("/"))
    start = f"{place}/" if place else ""
    return {start + name: checked(found[name]) for name in ordered if hasattr(found[name], "shape")}


def checked(array: Any) -> zarr.Array[Any]:
    """Return the array, after checking that its chunks fit into memory."""
    chunks = tuple(int(n) for n in array.chunks)
    if any(n < 1 for n in chunks) or any(int(n) < 0 for n in array.shape):
        raise FileFormatError(f"{array.path!r} has shape {array.shape} in pieces of {chunks}")
    size = math.prod(chunks) * array.dtype.itemsize
    check_memory(size, f"one piece {chunks} of {array.path!r}", "store it in smaller chunks")
    array.store.arrays[array.path] = array
    found: zarr.Array[Any] = array
    return found


def dimensions(array: zarr.Array[Any]) -> tuple[str, ...] | None:
    """Return the names of an array's dimensions, or None; a single number has none of them."""
    names: Any = array.attrs.get("_ARRAY_DIMENSIONS")
    if array.metadata.zarr_format == 3:
        names = array.metadata.dimension_names
    names = () if not array.shape else names
    named = isinstance(names, (list, tuple)) and all(isinstance(name, str) for name in names)
    return tuple(names) if named else None
