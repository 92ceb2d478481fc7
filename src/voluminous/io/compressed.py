"""Reader for compressed files (gzip, bzip2, xz): decompresses, then applies another reader."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import FileFormatError, MemoryNeededError
from ..memory import available_memory
from .contract import FieldInfo, Reader
from .guard import reading
from .payload import is_packed, unpacked

if TYPE_CHECKING:
    from ..volume import Volume

_PIECE = 1 << 20


class _Any(dict[str, str]):
    """Accepts any option name: the reader of the content checks them."""

    def __contains__(self, name: object) -> bool:
        return True


class PackedReader(Reader):
    """Applies another reader to the content: `find` returns it, `check` checks its options."""

    name = "packed"
    description = "a packed file (gzip, bzip2 or xz)"
    suffixes = (".gz", ".bz2", ".xz")
    options = _Any()

    def __init__(
        self, find: Callable[[Path], Reader], check: Callable[[Reader, dict[str, Any]], None]
    ) -> None:
        self._find, self._check = find, check

    def matches(self, path: Path, head: bytes) -> bool:
        return is_packed(head)

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        with self._inside(path, options) as (reader, inner):
            volume = reader.read(inner, fields, **options)
            # Not to be read again: by other processes, for example.
            return volume.with_arrays({name: volume.array(name) for name in volume.fields})

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        with self._inside(path, options) as (reader, inner):
            return reader.info(inner, **options)

    @contextmanager
    def _inside(self, path: Path, options: dict[str, Any]) -> Iterator[tuple[Reader, Path]]:
        with tempfile.TemporaryDirectory(prefix="voluminous-") as directory:
            inner = Path(directory, path.stem)
            _unpack(path, inner)
            try:
                reader = self._find(inner)
            except FileFormatError as error:  # do not show our temporary directory to the user
                raise FileFormatError(str(error).replace(f"{inner.parent}/", "")) from error
            if reader is self:
                raise FileFormatError(
                    f"{inner.name} inside is packed once more; unpack it yourself"
                )
            self._check(reader, options)
            with reading(Path(inner.name), reader.description):
                yield reader, inner


def _unpack(path: Path, target: Path) -> None:
    room, written = min(available_memory(), shutil.disk_usage(target.parent).free), 0
    with unpacked(path) as source, open(target, "wb") as file:
        while piece := source.read(_PIECE):
            written += len(piece)
            if written > room:
                raise MemoryNeededError(
                    f"unpacking needs more than the {room} bytes that are available in memory and "
                    f"in {target.parent.parent}; unpack it yourself, and open the file inside"
                )
            file.write(piece)
