"""NPY: one array, mapped into memory rather than read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ..names import field_name
from .entry import Entry
from .named_arrays import NamedArraysReader
from .npy_format import MAGIC, header


class NPYReader(NamedArraysReader):
    """One field; its name is the file's, or the option `name`."""

    name = "npy"
    description = "a NumPy array (.npy)"
    suffixes = (".npy",)
    options = {  # noqa: RUF012 - as in Reader
        **NamedArraysReader.options,
        "name": "name of the field; by default that of the file without suffix",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return head.startswith(MAGIC)

    @contextmanager
    def entries(
        self, path: Path, only: str | None = None, **options: Any
    ) -> Iterator[dict[str, Entry]]:
        with open(path, "rb") as file:
            shape, fortran, dtype = header(file)
            _check_length(path, file.tell(), shape, dtype)

        def load(index: Any = ...) -> np.ndarray:
            values: np.ndarray = np.load(path, mmap_mode="r", allow_pickle=False)[index]
            return values

        # A volume copies what lies in another order, or in foreign bytes.
        mapped = not fortran and dtype.isnative
        yield {options.get("name") or field_name(path.stem): Entry(shape, dtype, "", load, mapped)}


def _check_length(path: Path, start: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    if dtype.hasobject:  # refused later, by name
        return
    expected = start + dtype.itemsize * int(np.prod(shape, dtype=object))
    found = path.stat().st_size
    if found < expected:
        raise FileFormatError(
            f"the file is cut short: {found} bytes, but shape {shape} of {dtype} takes {expected}"
        )
