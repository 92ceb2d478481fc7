"""Arrays in legacy files: what each keyword says of the values that follow it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any
from urllib.parse import unquote

import numpy as np

from ...errors import FileFormatError
from ..unit_texts import known_unit
from .dataset import CELL, POINT, Array
from .legacy_values import Lines, Stored
from .meta import plain_value

# Keyword → values at each point, of arrays that tell "KEYWORD name type".
_FIXED = {
    "VECTORS": 3,
    "NORMALS": 3,
    "TENSORS": 9,
    "TENSORS6": 6,
    "GLOBAL_IDS": 1,
    "PEDIGREE_IDS": 1,
    "EDGE_FLAGS": 1,
}


class Arrays:
    """Reads what comes behind ``POINT_DATA`` and ``CELL_DATA``, and fields before them.

    Parameters
    ----------
    lines : Lines
        The file.
    counts : callable
        Returns the shape (nz, ny, nx) of values at points or in cells.
    """

    def __init__(self, lines: Lines, counts: Callable[[str], tuple[int, ...]]) -> None:
        self._lines, self._counts = lines, counts
        self.at = ""
        self.found: list[Array] = []
        self.remarks: dict[str, Any] = {}
        self.active: dict[str, str] = {}
        self._components = 1  # of the latest array, which METADATA is about
        self._latest: int | None = None
        self.keywords: dict[str, Callable[[list[str]], None]] = {
            "POINT_DATA": lambda words: self._place(POINT, words),
            "CELL_DATA": lambda words: self._place(CELL, words),
            "SCALARS": self._scalars,
            "COLOR_SCALARS": self._colors,
            "TEXTURE_COORDINATES": lambda w: self._add(w[1], w[3], int(w[2])),
            "LOOKUP_TABLE": self._table,
            "FIELD": self._field,
            "METADATA": self._metadata,
        }
        for keyword, components in _FIXED.items():
            self.keywords[keyword] = lambda w, n=components: self._add(w[1], w[2], n)  # type: ignore

    def other(self, name: str, kind: str, count: int, components: int = 1) -> Stored:
        """Pass over values that are no field, such as coordinates."""
        self._latest, self._components = None, components
        return self._lines.stored(name, kind, count)

    def _place(self, at: str, words: list[str]) -> None:
        expected = int(np.prod(self._counts(at), dtype=object))
        if int(words[1]) != expected:
            raise FileFormatError(
                f"expected {words[0]} {expected}, as the dimensions say, got {words[1][:40]}"
            )
        self.at = at

    def _add(self, name: str, kind: str, components: int) -> None:
        """Add an array that begins here."""
        if not self.at:
            raise FileFormatError(f"array {name!r}: expected POINT_DATA or CELL_DATA before it")
        shape = (*self._counts(self.at), components)
        stored = self._lines.stored(unquote(name), kind, int(np.prod(shape, dtype=object)))

        def load() -> np.ndarray:
            return stored.values().reshape(shape)

        self._latest, self._components = len(self.found), components
        self.found.append(Array(unquote(name), self.at, components, stored.dtype, load))

    def _scalars(self, words: list[str]) -> None:
        components = int(words[3]) if len(words) > 3 else 1
        table = self._lines.words()
        if not table or table[0].upper() != "LOOKUP_TABLE":
            raise FileFormatError(f"SCALARS {words[1]}: expected LOOKUP_TABLE, got {table[:2]}")
        self.active.setdefault(self.at, unquote(words[1]))
        self._add(words[1], words[2], components)

    def _colors(self, words: list[str]) -> None:
        # As text they are fractions, in binary files bytes.
        self._add(words[1], "unsigned_char" if self._lines.binary else "float", int(words[2]))

    def _table(self, words: list[str]) -> None:
        kind = "unsigned_char" if self._lines.binary else "float"
        self.other(words[1], kind, 4 * int(words[2]), 4)

    def _field(self, words: list[str]) -> None:
        for _ in range(int(words[2])):
            told = self._lines.words()
            if told and told[0].upper() == "METADATA":  # of the array before
                self._metadata(told)
                told = self._lines.words()
            if len(told) < 4:
                raise FileFormatError(f"FIELD {words[1]}: expected {words[2]} arrays in it")
            self._field_array(told[0], int(told[1]), int(told[2]), told[3])

    def _field_array(self, name: str, components: int, tuples: int, kind: str) -> None:
        if kind.lower() == "string":
            self._latest, self._components = None, components
            texts = self._lines.texts(components * tuples)
            self.remarks[unquote(name)] = "\n".join(unquote(text) for text in texts)
        elif not self.at:
            if components * tuples:  # a list may be empty
                stored = self.other(name, kind, components * tuples, components)
                self._remark(unquote(name), stored)
        elif tuples != np.prod(self._counts(self.at), dtype=object):
            raise FileFormatError(
                f"array {unquote(name)!r}: {tuples} tuples, expected one for each {self.at}"
            )
        else:
            self._add(name, kind, components)

    def _remark(self, name: str, stored: Stored) -> None:
        if stored.count <= 16:
            self.remarks[name] = plain_value(stored.values())

    def _metadata(self, words: list[str]) -> None:
        """Read what is told of the latest array, up to an empty line."""
        while line := self._lines.line():
            if line.upper() == "COMPONENT_NAMES":
                labels = tuple(unquote(self._lines.line()) for _ in range(self._components))
                self._tell(labels=labels if all(labels) else ())
            elif line.startswith("NAME UNITS_LABEL"):
                self._tell(unit=known_unit(unquote(self._lines.line().partition(" ")[2])))

    def _tell(self, **told: Any) -> None:
        if self._latest is not None:
            self.found[self._latest] = replace(self.found[self._latest], **told)
