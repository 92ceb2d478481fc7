"""Data files on the command line: the options that say how they are read, for all commands."""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError

if TYPE_CHECKING:
    from ..volume import Volume


@dataclass(frozen=True)
class DataFile:
    """A data file, and how it is read.

    Attributes
    ----------
    path : Path
        The file or directory.
    format : str or None
        Name of the reader, if the file does not tell.
    options : dict
        The reader's options, as plain values.
    fields : None, list or dict
        Which fields, as for `voluminous.open`.
    """

    path: Path
    format: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    fields: Any = None

    @classmethod
    def given(
        cls, path: Path, format: str | None, options: Mapping[str, Any], fields: Any = None
    ) -> DataFile:
        """Return a file of which ``--set`` may give format and fields, with ``volume.`` or without.

        Raises
        ------
        InputError
            If one is given twice, or of the wrong kind, or for a path.
        """
        rest = {key.removeprefix("volume."): value for key, value in options.items()}
        own = {"format": format, "fields": fields}
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

    def open(self, fields: Any = None) -> Volume:
        """Return the volume, with fields that are read when they are first used."""
        from ..io.registry import open_lazily

        chosen = self.fields if fields is None else fields
        return open_lazily(self.path, chosen, format=self.format, **self.typed())

    def typed(self) -> dict[str, Any]:
        """Return the options as readers take them: texts such as "0.1 pc" are quantities."""
        from ..scene.source import typed_options

        return typed_options(self.options)

    def section(self, fields: Any = None, path: str | None = None) -> dict[str, Any]:
        """Return ``[volume]`` of a scene."""
        given = {"format": self.format, "fields": fields or self.fields}
        told = {key: value for key, value in given.items() if value}
        return {"path": path or str(self.path), **told, **self.options}

    def call(self, fields: Any = None) -> str:
        """Return the line of Python that opens it."""
        options = {key: value for key, value in self.section(fields).items() if key != "path"}
        listed = [f"{key}={value!r}" for key, value in options.items()]
        return f"vm.open({', '.join([repr(str(self.path)), *listed])})"

    def words(self) -> str:
        """Return file and options for a command line."""
        parts = [str(self.path)]
        parts += ["--format", self.format] if self.format else []
        for key, value in self.options.items():
            parts += ["--set", f"{key}={value if isinstance(value, str) else json.dumps(value)}"]
        return shlex.join(parts)


def add_reading_options(parser: Any) -> None:
    """Add the options that say how a data file is read."""
    parser.add_argument("--format", metavar="NAME", help="format, if the file itself does not tell")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="option of the format, such as unit=pc; voluminous formats NAME lists them",
    )


def add_fields_option(parser: Any, what: str) -> None:
    """Add the option that chooses fields."""
    parser.add_argument(
        "--fields",
        action="append",
        metavar="NAME,…",
        help=f"{what}; NAME=PLACE for one by its place in the file",
    )


def data_file(path: Path, args: argparse.Namespace) -> DataFile:
    """Return the file that arguments speak of, read with ``--format``, ``--set``, ``--fields``."""
    options = dict(assignment(text, "unit=pc") for text in args.set)
    return DataFile.given(path, args.format, options, chosen_fields(getattr(args, "fields", None)))


def assignment(text: str, example: str) -> tuple[str, Any]:
    """Return key and value of ``unit=pc``.

    Raises
    ------
    InputError
        If there is no key, or no equals sign.
    """
    from ..scene.toml import value

    key, equals, given = text.partition("=")
    if not equals or not key.strip():
        raise InputError(f"--set expects KEY=VALUE such as {example}, got {text!r}")
    return key.strip(), value(given.strip())


def chosen_fields(given: list[str] | None) -> Any:
    """Return the fields that ``--fields`` names: None, a list, or a table name → place."""
    names = [name.strip() for text in given or [] for name in text.split(",") if name.strip()]
    if not names:
        if given:
            raise InputError("--fields expects NAME,NAME,… or NAME=PLACE,…")
        return None
    if not any("=" in name for name in names):
        return names
    pairs = [name.partition("=") for name in names]
    return {name.strip(): (place or name).strip() for name, _, place in pairs}
