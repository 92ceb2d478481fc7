"""Data files on the command line: reading options shared by all commands."""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, VoluminousError
from ..files import url_of
from .common import add_several, settings

if TYPE_CHECKING:
    from ..io import FieldInfo, Reader
    from ..io.contract import FieldChoice
    from ..volume import Volume


@dataclass(frozen=True)
class DataFile:
    """A data file with its format, if the file does not tell, reading options, and fields.

    With `more` files it is one volume.
    """

    path: Path
    format: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    fields: FieldChoice = None
    more: Sequence[Path] = ()

    def open(self, fields: FieldChoice = None) -> Volume:
        """Return the volume; its fields are read on first use."""
        from ..io.registry import open_lazily

        chosen = self.fields if fields is None else fields
        path = [self.path, *self.more] if self.more else self.path
        return open_lazily(path, chosen, format=self.format, **self.typed())

    def info(self) -> tuple[Reader, list[FieldInfo]]:
        """Return the reader and what it says of the fields in the file."""
        from ..io import find_reader
        from ..io.guard import reading

        reader = find_reader(self.path, self.format)
        with reading(self.path, reader.description):
            return reader, list(reader.info(self.path, **self.typed()))

    def typed(self) -> dict[str, Any]:
        """Return the options as readers expect them: texts such as "0.1 pc" become quantities."""
        from ..scene.sections import typed_options

        return typed_options(self.options)

    def section(self, fields: FieldChoice = None, path: str | None = None) -> dict[str, Any]:
        """Return ``[volume]`` of a scene."""
        given = {"format": self.format, "fields": fields or self.fields}
        chosen = {key: value for key, value in given.items() if value}
        first = path or url_of(self.path) or str(self.path)
        beside = [os.path.relpath(one, self.path.parent) if path else str(one) for one in self.more]
        return {"path": [first, *beside] if beside else first, **chosen, **self.options}

    def call(self) -> str:
        """Return the Python expression that opens the file."""
        path, *options = self.section().items()
        return f"vm.open({', '.join([repr(path[1]), *(f'{k}={v!r}' for k, v in options)])})"

    def words(self) -> str:
        """Return file and options as command line arguments."""
        parts = [url_of(self.path) or str(self.path)]
        parts += ["--format", self.format] if self.format else []
        for key, value in self.options.items():
            parts += ["--set", f"{key}={value if isinstance(value, str) else json.dumps(value)}"]
        return shlex.join(parts)


def add_reading_options(parser: argparse._ActionsContainer) -> None:
    """Add the reading options of data files."""
    parser.add_argument("--format", metavar="NAME", help="format, if the file itself does not tell")
    help = "option of the format, such as unit=pc; voluminous formats NAME lists them"
    add_several(parser, "--set", "KEY=VALUE", help)


def add_fields_option(parser: argparse._ActionsContainer, what: str) -> None:
    """Add the option that chooses fields."""
    add_several(
        parser, "--fields", "NAME,…", f"{what}; NAME=PLACE for one by its place in the file"
    )


def data_file(
    path: Path, args: argparse.Namespace, options: Mapping[str, Any] | None = None
) -> DataFile:
    """Return the data file with ``--format``, ``--fields``, and `options`, else ``--set``."""
    given = settings(args.set, "unit=pc") if options is None else options
    given = {key.removeprefix("volume."): value for key, value in given.items()}
    for key in {"path", "model", "format", "fields"} & given.keys():
        raise InputError(
            f"--set {key}: the file is the argument of the command, {path}; --format and --fields "
            "are options of their own"
        )
    fields = chosen_fields(vars(args).get("fields", []))
    return DataFile(path, args.format, given, fields, vars(args).get("more", ()))


def chosen_fields(given: list[str]) -> Any:
    """Return the fields of ``--fields``: None, a list, or a mapping name → path in the file."""
    names = [name.strip() for text in given for name in text.split(",") if name.strip()]
    if given and not names:
        raise InputError("--fields expects NAME,NAME,… or NAME=PLACE,…")
    if not any("=" in name for name in names):
        return names or None
    pairs = [name.partition("=") for name in names]
    return {name.strip(): (place or name).strip() for name, _, place in pairs}


# Usual names of the density …
_FIRST = re.compile(r"(gas_|mass_)?density|rho|dens|(number_)?density|n|nh|n_h", re.I)
# … and similar names.
_LIKE = re.compile(r".*densit(y|ies).*|.*numdens.*|rho.*|.*_rho|intensity|brightness.*|data", re.I)
# Vector components rank below scalars.
_COMPONENT = re.compile(
    r"[xyz]_.*|.*_([xyzr]|theta|phi)|(v|vel|velocity|u|b|bcc|mag|mom|e|acc)_?[xyz123]", re.I
)
# Coordinates and cell indices.
_PLACE = re.compile(
    r"([xyzr]|radius|distance|theta|phi|ra|dec|lon|lat|longitude|latitude|height|altitude|"
    r"velocity|frequency|wavelength|time|level|refinement_level|grid_level|index|"
    r"cell_.*|.*_index|.*_?ids?|d[xyz]|volume)_?",
    re.I,
)


def rank(name: str) -> int:
    """Return the rank of a field by its name; 0 is the most interesting."""
    for number, names in enumerate((_FIRST, _LIKE)):
        if names.fullmatch(name):
            return number
    return 2 + (_COMPONENT.fullmatch(name) is not None) + 2 * (_PLACE.fullmatch(name) is not None)


def first_field(volume: Volume) -> str | None:
    """Return the most interesting field; None if there is no field.

    A density is preferred, then the first field that is neither a vector component nor a
    coordinate. Constant fields come last. Fields are read in this order, chunk by chunk, until one
    is not constant.
    """
    if len(volume.fields) == 1:  # which need not be read
        return str(*volume.fields)
    ranked = sorted(volume.fields, key=rank)
    varying = (name for name in ranked if _varies(volume, name))
    return next(varying, ranked[0] if ranked else None)


def _varies(volume: Volume, name: str) -> bool:
    import numpy as np

    from .statistics import statistics

    store, ends = volume.store, set()
    shape = store.shape(0)
    if shape == store.chunks:  # and it stays in memory
        return statistics(volume.array(name)).varies
    for place in np.ndindex(*(-(-n // c) for n, c in zip(shape, store.chunks, strict=True))):
        low = [i * c for i, c in zip(place, store.chunks, strict=True)]
        high = [min(a + c, n) for a, c, n in zip(low, store.chunks, shape, strict=True)]
        found = statistics(store.read(name, low, high))
        if found.finite:
            ends |= {found.least, found.greatest}
        if len(ends) > 1:
            return True
    return False


def opened(data: DataFile, expr: str | None) -> tuple[Volume, dict[str, str] | None]:
    """Open all fields; if they do not fit together, those of the expression, or the first.

    Returns the volume, whose fields are unread, and their places in the file if not all are open.
    """
    try:
        return data.open(), None
    except VoluminousError:
        if data.more:
            raise
        for places in _alternatives(data, expr) if data.fields is None else ():
            try:
                return data.open(places), places
            except VoluminousError:
                continue
        raise


def _alternatives(data: DataFile, expr: str | None) -> Iterator[dict[str, str]]:
    from ..expressions import Expression

    _, known = data.info()
    if expr is None:
        for field in sorted(known, key=lambda field: rank(field.name)):
            yield {field.name: field.place}
    else:
        names = Expression(expr).names
        yield {field.name: field.place for field in reversed(known) if field.name in names}


def is_image(path: Path) -> bool:
    """Return True for an image file; the content decides if volumes share the suffix."""
    from ..image.formats import FORMATS
    from ..io import find_reader

    if not any(path.suffix.lower() in form.suffixes for form in FORMATS):
        return False
    try:
        return find_reader(path).holds_image(path)
    except VoluminousError:  # no volume format fits, or the file does not exist
        return True


def is_series(files: Sequence[Path], format: str | None) -> bool:
    """Return whether files are steps of a series: with the same names and fields but for numbers.

    Others are parts of one volume.
    """
    if len({_unnumbered(file.name) for file in files}) > 1 or len(files) < 2:
        return False
    names = []
    for file in files[:2]:
        fields = DataFile(file, format).info()[1]
        names.append([_unnumbered(field.name) for field in fields])
    return names[0] == names[1]


def _unnumbered(name: str) -> str:
    return re.sub(r"\d+", "#", name)


def common_name(files: Sequence[Path], format: str | None) -> dict[str, Any]:
    """Return the option by which a field that is called as its file is called alike in all."""
    from ..io.names import field_name
    from ..io.scanners.voxels import stem

    reader, fields = DataFile(files[0], format).info()
    own = "name" in reader.options and [field.name for field in fields][:1] == [
        field_name(stem(files[0]))
    ]
    return {"name": re.sub(r"_?\d+$", "", field_name(stem(files[0]))) or "data"} if own else {}


def is_volume(path: Path, format: str | None = None) -> bool:
    """Return True for a data file; False for a scene, or an image that contains one."""
    from ..io import find_reader

    if format is None and (path.suffix.lower() == ".toml" or is_image(path)):
        return False
    find_reader(path, format)
    return True


def bytes_of(path: Path) -> int:
    """Return the size in bytes of a file, or of all files in a directory."""
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def in_bytes(size: float) -> str:
    """Return a number of bytes as text with a unit.

    Examples
    --------
    >>> in_bytes(1000), in_bytes(3 << 20)
    ('1000 bytes', '3 MiB')
    """
    for unit in ("bytes", "KiB", "MiB", "GiB"):
        if size < 1024 or unit == "GiB":
            break
        size /= 1024
    return f"{size:.4g} {unit}"
