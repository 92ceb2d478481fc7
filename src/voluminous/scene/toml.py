"""TOML in and out: the standard library reads it; what a scene needs of it is written here."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Mapping
from typing import Any

from ..errors import FileFormatError, InputError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def loads(text: str) -> dict[str, Any]:
    """Return the tables of a TOML document.

    Raises
    ------
    FileFormatError
        If it is not TOML; names line and column.
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(f"not valid TOML: {error}") from error


def value(text: str) -> Any:
    """Return a value as it would stand behind ``key =``; anything else is taken as a text.

    Examples
    --------
    >>> value("40"), value("[1, 2]"), value("0.1 pc")
    (40, [1, 2], '0.1 pc')
    """
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def dumps(tables: Mapping[str, Any]) -> str:
    """Return a TOML document; `loads` gives back the same values.

    Raises
    ------
    InputError
        If there is a value that TOML cannot hold.
    """
    return "\n".join(_lines(tables, "")).strip() + "\n"


def _lines(table: Mapping[str, Any], path: str) -> Iterator[str]:
    """Yield the plain values of a table, then the tables in it, each under its header."""
    tables = {k: v for k, v in table.items() if isinstance(v, Mapping) or _is_array_of_tables(v)}
    for key, content in table.items():
        if key not in tables:
            yield f"{_key(key)} = {inline(content)}"
    for key, content in tables.items():
        inner = f"{path}{_key(key)}"
        for one in content if isinstance(content, list) else [content]:
            yield f"\n[[{inner}]]" if isinstance(content, list) else f"\n[{inner}]"
            yield from _lines(one, f"{inner}.")


def _is_array_of_tables(content: Any) -> bool:
    return (
        isinstance(content, list) and bool(content) and all(isinstance(c, Mapping) for c in content)
    )


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _text(key)


def inline(content: Any) -> str:
    """Return a value as it stands behind ``key =``."""
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
    except UnicodeEncodeError:  # a name of a file that is no UTF-8
        raise InputError(f"a scene file cannot hold {text!r}, which is no UTF-8") from None
    # JSON's escapes are TOML's, but for the one control character that JSON leaves as it is.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
