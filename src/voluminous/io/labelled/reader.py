"""What readers of data with named dimensions share; a format has to provide `dataset`."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..contract import FieldInfo, Reader
from . import box, layout
from .convert import AT_ONCE, volume_of
from .layout import Layout, selected
from .variables import infos

if TYPE_CHECKING:
    import xarray

    from ...volume import Volume


class LabelledReader(Reader):
    """Variables on coordinates, opened by xarray; each is read when it is first used."""

    options = {  # noqa: RUF012 - as in Reader
        **layout.OPTIONS,
        **box.OPTIONS,
        "group": "the group in the file; by default the outermost",
    }
    packages: tuple[str, ...] = ("xarray",)
    extra = "arrays"

    def dataset(self, path: Path, group: str | None) -> AbstractContextManager[xarray.Dataset]:
        """Return a context that gives what is in a group, decoded but not read."""
        raise NotImplementedError

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        source = _Source(self, path, options.pop("group", None), options)

        def reader_of(layout: Layout, place: str) -> Callable[[], np.ndarray]:
            return functools.partial(source.values, layout, place)

        with source.opened() as data:
            volume = volume_of(data, fields, options, reader_of)
            if volume.bytes_waiting <= AT_ONCE:
                volume.load()  # to look what there is again for each field would take longer
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        with self.dataset(path, options.get("group")) as data:
            return infos(data)


class _Source:
    """Where fields are read from: a file that is open, or opened for each."""

    def __init__(
        self, reader: LabelledReader, path: Path, group: str | None, options: dict[str, Any]
    ) -> None:
        self.reader, self.path, self.group, self.options = reader, path, group, options
        self.data: xarray.Dataset | None = None

    @contextmanager
    def opened(self) -> Iterator[xarray.Dataset]:
        if self.data is not None:
            yield self.data
            return
        with self.reader.dataset(self.path, self.group) as data:
            try:
                self.data = selected(data, self.options)
                yield self.data
            finally:
                self.data = None

    def values(self, layout: Layout, place: str) -> np.ndarray:
        with self.opened() as data:
            return layout.values(data[place])
