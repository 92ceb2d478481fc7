"""Data files on the command line: reading options shared by all commands."""

from __future__ import annotations

import argparse
import json
import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from ..errors import FileFormatError, InputError, VoluminousError

if TYPE_CHECKING:
    import numpy as np

    from ..io.contract import FieldChoice
    from ..volume import Volume


@dataclass(frozen=True)
class DataFile:
    """A data file with its reading options.

    Attributes
    ----------
    path : Path
        The file or directory.
    format : str or None
        Name of the reader, if the file does not determine it.
    options : dict
        The reader's options, as plain values.
    fields : None, list or dict
        Which fields, as for `voluminous.open`.
    """

    path: Path
    format: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    fields: FieldChoice = None

    @classmethod
    def given(
        cls, path: Path, format: str | None, options: Mapping[str, Any], fields: FieldChoice = None
    ) -> DataFile:
        """Return a data file; `options` may hold format and fields, with or without ``volume.``."""
        rest = {key.removeprefix("volume."): value for key, value in options.items()}
        own: dict[str, Any] = {"format": format, "fields": fields}
        for key, value in own.items():
            if key not in rest:
                continue
            told = rest.pop(key)
            if value is not None and value != told:
                raise InputError(f"--{key} and --set {key}={told}: give one of them")
            if key == "format" and not isinstance(told, str):
                raise InputError(f"--set format expects the name of a format, got {told!r}")
            own[key] = chosen_fields([told]) if key == "fields" and isinstance(told, str) else told
        for key in {"path", "model"} & rest.keys():
            raise InputError(f"--set {key}: the file is the argument of the command, {path}")
        return cls(path, own["format"], rest, own["fields"])

    def open(self, fields: FieldChoice = None) -> Volume:
        """Return the volume; its fields are read on first use."""
        from ..io.registry import open_lazily

        chosen = self.fields if fields is None else fields
        return open_lazily(self.path, chosen, format=self.format, **self.typed())

    def typed(self) -> dict[str, Any]:
        """Return the options as readers expect them: texts such as "0.1 pc" become quantities."""
        from ..scene.source import typed_options

        return typed_options(self.options)

    def section(self, fields: FieldChoice = None, path: str | None = None) -> dict[str, Any]:
        """Return ``[volume]`` of a scene."""
        given = {"format": self.format, "fields": fields or self.fields}
        told = {key: value for key, value in given.items() if value}
        return {"path": path or str(self.path), **told, **self.options}

    def call(self, fields: FieldChoice = None) -> str:
        """Return the Python expression that opens the file."""
        options = {key: value for key, value in self.section(fields).items() if key != "path"}
        listed = [f"{key}={value!r}" for key, value in options.items()]
        return f"vm.open({', '.join([repr(str(self.path)), *listed])})"

    def words(self) -> str:
        """Return file and options as command line arguments."""
        parts = [str(self.path)]
        parts += ["--format", self.format] if self.format else []
        for key, value in self.options.items():
            parts += ["--set", f"{key}={value if isinstance(value, str) else json.dumps(value)}"]
        return shlex.join(parts)


def add_reading_options(parser: argparse._ActionsContainer) -> None:
    """Add the reading options of data files."""
    parser.add_argument("--format", metavar="NAME", help="format, if the file itself does not tell")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="option of the format, such as unit=pc; voluminous formats NAME lists them",
    )


def add_fields_option(parser: argparse._ActionsContainer, what: str) -> None:
    """Add the option that chooses fields."""
    parser.add_argument(
        "--fields",
        action="append",
        metavar="NAME,…",
        help=f"{what}; NAME=PLACE for one by its place in the file",
    )


def data_file(path: Path, args: argparse.Namespace) -> DataFile:
    """Return the data file with the options ``--format``, ``--set`` and ``--fields``."""
    options = dict(assignment(text, "unit=pc") for text in args.set)
    return DataFile.given(path, args.format, options, chosen_fields(getattr(args, "fields", None)))


def assignment(text: str, example: str) -> tuple[str, Any]:
    """Return key and value of ``unit=pc``."""
    from ..scene.settings import value

    key, equals, given = text.partition("=")
    if not equals or not key.strip():
        raise InputError(f"--set expects KEY=VALUE such as {example}, got {text!r}")
    return key.strip(), value(given.strip())


def chosen_fields(given: list[str] | None) -> Any:
    """Return the fields of ``--fields``: None, a list, or a mapping name → path in the file."""
    names = [name.strip() for text in given or [] for name in text.split(",") if name.strip()]
    if not names:
        if given:
            raise InputError("--fields expects NAME,NAME,… or NAME=PLACE,…")
        return None
    if not any("=" in name for name in names):
        return names
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
_PIECE = 1 << 20


def rank(name: str) -> int:
    """Return the rank of a field by its name; 0 is the most interesting."""
    for number, names in enumerate((_FIRST, _LIKE)):
        if names.fullmatch(name):
            return number
    return 2 + (_COMPONENT.fullmatch(name) is not None) + 2 * (_PLACE.fullmatch(name) is not None)


def first_field(volume: Volume) -> str | None:
    """Return the most interesting field; None if there is no field.

    A density is preferred, then the first field that is neither a vector component nor a
    coordinate. Constant fields come last. Fields are read in this order, until one is not constant.
    """
    ranked = sorted(volume.fields, key=rank)
    found = next((name for name in ranked if varies(volume.array(name))), None)
    return found if found is not None else next(iter(ranked), None)


def varies(array: np.ndarray) -> bool:
    """Return True if an array has at least two different finite values."""
    import numpy as np

    flat, seen = array.reshape(-1), None
    for start in range(0, flat.size, _PIECE):
        piece = flat[start : start + _PIECE]
        good = piece[np.isfinite(piece)]
        if good.size:
            seen = good[0] if seen is None else seen
            if (good != seen).any():
                return True
    return False


@dataclass
class Opened:
    """A volume with unread fields, and their paths in the file if these are needed."""

    volume: Volume
    places: dict[str, str] | None = None

    def keep(self, used: set[str]) -> Any:
        """Drop unused fields; return the scene's entry ``fields`` for the others."""
        for name in self.volume.fields:
            if name not in used:
                del self.volume[name]
        names = list(self.volume.fields)
        return names if self.places is None else {name: self.places[name] for name in names}


def opened(data: DataFile, expr: str | None) -> Opened:
    """Open all fields; if they do not fit together, those of the expression, or the first."""
    try:
        return Opened(data.open())
    except VoluminousError:
        if data.fields is not None:
            raise
        for places in _alternatives(data, expr):
            try:
                return Opened(data.open(places), places)
            except VoluminousError:
                continue
        raise


def _alternatives(data: DataFile, expr: str | None) -> Iterator[dict[str, str]]:
    from ..expressions import Expression
    from ..io import find_reader
    from ..io.guard import reading

    reader = find_reader(data.path, data.format)
    with reading(data.path, reader.description):
        known = reader.info(data.path, **data.typed())
    if expr is None:
        for field in sorted(known, key=lambda field: rank(field.name)):
            yield {field.name: field.place}
    else:
        names = Expression(expr).names
        yield {field.name: field.place for field in reversed(known) if field.name in names}


_NONE: Mapping[str, Any] = MappingProxyType({})


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


def is_volume(path: Path, format: str | None = None, given: Mapping[str, Any] = _NONE) -> bool:
    """Return True for a data file; False for a scene, or an image that contains one.

    `given` (from ``--set``) may contain the format.
    """
    from ..io import find_reader
    from ..io.registry import reader_for_suffix

    if format is None and (path.suffix.lower() == ".toml" or is_image(path)):
        return False
    told = given.get("format", given.get("volume.format"))
    try:
        find_reader(path, format or (told if isinstance(told, str) else None))
    except FileFormatError:
        if _is_text(path) and reader_for_suffix(path) is None:  # a scene with another suffix
            return False
        raise
    return True


def _is_text(path: Path) -> bool:
    if not path.is_file():
        return False
    try:
        path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return False
    return path.stat().st_size > 0


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
