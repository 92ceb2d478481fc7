"""Scene settings as TOML: reads with the standard library, and writes the subset scenes need."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ..errors import FileFormatError, InputError, check_name
from ..files import url_of
from ..regions import Region
from ..units import described

SECTIONS = ("volume", "medium", "project", "object", "camera", "render", "image")
_PATHS = (("volume", "path"), ("render", "background"))
# Sections that may occur several times.
_LISTS = ("medium", "object")


def plain_sections(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return all sections, in order, as tables of plain values."""
    if not isinstance(settings, Mapping):
        raise InputError(f"a scene is a dictionary of sections, got {type(settings).__name__}")
    for name in settings:
        check_name("section", name, SECTIONS)
    for name in ("volume", "medium"):
        if not settings.get(name) and not (name == "medium" and settings.get("project")):
            raise InputError(f"the section {name!r} is missing or empty; a scene needs it")
    sections: dict[str, Any] = {}
    for name in SECTIONS:
        section = settings.get(name, {})
        if name not in _LISTS:
            section = _described(section)
            if not isinstance(section, Mapping):
                raise InputError(f"expected a table [{name}], got {name} = {section!r}")
        else:
            given = list(section.components()) if hasattr(section, "components") else section
            several = isinstance(given, (list, tuple))
            section = [_described(one) for one in (given if several else [given] if given else [])]
            for number, table in enumerate(section, start=1):
                if not isinstance(table, Mapping):
                    raise InputError(
                        f"expected tables [[{name}]], got {table!r} as number {number}"
                    )
        sections[name] = plain_value(section)
    return sections


def _described(thing: Any) -> Any:
    if not hasattr(thing, "describe"):
        return thing
    return {key: value for key, value in thing.describe().items() if value is not None}


def plain_value(value: Any) -> Any:
    """Return a Python value in the form of a scene file; unsupported values stay unchanged.

    Arrays and tuples become lists, NumPy scalars Python numbers, paths strings, and quantities
    strings such as "1.0 pc".

    Examples
    --------
    >>> plain_value({"shift": (np.float64(0.5), 1), "path": Path("a.h5")})
    {'shift': [0.5, 1], 'path': 'a.h5'}
    """
    if isinstance(value, Mapping):
        return {key: plain_value(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_value(one) for one in value]
    if isinstance(value, Region):
        return value.describe()
    return os.fspath(value) if isinstance(value, os.PathLike) else described(value)


def set_value(settings: dict[str, Any], place: str, value: Any) -> None:
    """Set the value of a key such as ``medium.1.color``; missing tables are created."""
    *path, last = place.split(".")
    check_name("section", (*path, last)[0], SECTIONS)
    table: Any = settings
    for step, key in enumerate(path):
        if not isinstance(table, list):
            table = table.setdefault(key, [] if key in _LISTS and not step else {})
        elif key.isdigit() and 1 <= int(key) <= len(table):
            table = table[int(key) - 1]
        else:
            known = f"expected a number from 1 to {len(table)}"
            known = known if table else "there is none to change"
            raise InputError(f"{place!r}: {known}, got {key!r}")
        if not isinstance(table, (dict, list)):
            raise InputError(f"{'.'.join(path[: step + 1])} is a value, not a table: {table!r}")
    if isinstance(table, list):
        raise InputError(f"{place!r}: say which of the {len(table)}, such as '{path[0]}.1.color'")
    table[last] = value


def with_paths(settings: dict[str, Any], change: Callable[[str], str]) -> dict[str, Any]:
    """Return settings with `change` applied to all file paths."""
    changed = dict(settings)
    for section, key in _PATHS:
        path = changed.get(section, {}).get(key)
        if isinstance(path, str) or (path and isinstance(path, list) and key == "path"):
            new = change(path) if isinstance(path, str) else [change(one) for one in path]
            changed[section] = {**changed[section], key: new}
    return changed


def relative_path(old: Path, path: str, new: Path) -> str:
    """Return a path relative to directory `old` as a path relative to directory `new`."""
    expanded = Path(os.path.expanduser(path))
    if expanded.is_absolute() or url_of(expanded):
        return path
    return Path(os.path.relpath(old / expanded, new)).as_posix()


if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def loads(text: str) -> dict[str, Any]:
    """Return the tables of a TOML document."""
    try:
        tables: dict[str, Any] = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(f"not valid TOML: {error}") from error
    return tables


def value(text: str) -> Any:
    """Parse a value as TOML does after ``key =``; other text is returned as a string.

    Examples
    --------
    >>> value("40"), value("[1, 2]"), value("(1, 2)"), value("0.1 pc")
    (40, [1, 2], [1, 2], '0.1 pc')
    """
    if text.startswith("(") and text.endswith(")"):  # as in Python
        listed = value(f"[{text[1:-1]}]")
        return listed if isinstance(listed, list) else text
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def dumps(tables: Mapping[str, Any]) -> str:
    """Return a TOML document; `loads` restores the same values."""
    return "\n".join(_lines(tables, "")).strip() + "\n"


def _lines(table: Mapping[str, Any], path: str) -> Iterator[str]:
    tables = {
        key: content
        for key, content in table.items()
        if isinstance(content, Mapping)
        or (isinstance(content, list) and content and all(isinstance(c, Mapping) for c in content))
    }
    for key, content in table.items():
        if key not in tables:
            yield f"{_key(key)} = {inline(content)}"
    for key, content in tables.items():
        inner = f"{path}{_key(key)}"
        for one in content if isinstance(content, list) else [content]:
            yield f"\n[[{inner}]]" if isinstance(content, list) else f"\n[{inner}]"
            yield from _lines(one, f"{inner}.")


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _text(key)


def inline(content: Any) -> str:
    """Return a value in inline form, as after ``key =``."""
    if isinstance(content, bool):
        return "true" if content else "false"
    if isinstance(content, (int, float)):
        return repr(content)
    if isinstance(content, str):
        return _text(content)
    if isinstance(content, (list, tuple)):
        return f"[{', '.join(inline(v) for v in content)}]"
    if isinstance(content, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {inline(v)}" for k, v in content.items()) + "}"
    raise InputError(f"a scene file cannot hold {content!r}")


def _text(text: str) -> str:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:  # a file name that is not valid UTF-8
        raise InputError(f"a scene file cannot hold {text!r}, which is no UTF-8") from None
    # JSON and TOML escapes agree, except for DEL, which JSON does not escape.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
