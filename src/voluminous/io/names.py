"""Field names: conversion to identifiers for expressions, and selection by the user."""

from __future__ import annotations

import keyword
import unicodedata
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from ..errors import InputError, unknown_name

if TYPE_CHECKING:
    from .contract import FieldChoice

# Suffixes of vector components, for the coordinates of all grids.
_COMPONENTS = (("x", "y", "z"), ("r", "theta", "phi"), ("R", "phi", "z"))


def field_name(place: str) -> str:
    """Return a name valid in expressions: the last part of a place, converted to an identifier.

    Examples
    --------
    >>> field_name("gas/x-velocity"), field_name("e")
    ('x_velocity', 'e_')
    """
    from ..expressions import CONSTANTS, FUNCTIONS
    from ..fields import COORDINATES

    # Expressions use this Unicode normal form.
    last = unicodedata.normalize("NFKC", place.rsplit("/", 1)[-1])
    name = "".join(c if f"_{c}".isidentifier() else "_" for c in last)
    name = name if name.isidentifier() else f"_{name}"
    reserved = name in FUNCTIONS or name in CONSTANTS or name in COORDINATES
    return f"{name}_" if reserved or keyword.iskeyword(name) else name


def chosen_fields(
    known: Mapping[str, str], fields: FieldChoice, kind: str = "field"
) -> dict[str, str]:
    """Return {name: place} for the fields that the user requests."""
    if fields is None:
        return _distinct((name, place) for place, name in known.items())
    if isinstance(fields, Mapping):
        return {name: _place(known, place, kind) for name, place in fields.items()}
    asked = [fields] if isinstance(fields, str) else list(fields)
    if not asked:
        raise InputError("fields is empty; name at least one, or leave it out to read all")
    return _distinct(
        (known[place], place) for name in asked for place in _places(known, name, kind)
    )


def _places(known: Mapping[str, str], asked: Any, kind: str) -> list[str]:
    names = {name: place for place, name in known.items()}
    if isinstance(asked, str) and asked.strip("/") not in known and asked not in names:
        for endings in _COMPONENTS:
            parts = [f"{asked}_{ending}" for ending in endings]
            if all(part in names for part in parts):
                return [names[part] for part in parts]
    return [_place(known, asked, kind)]


def _place(known: Mapping[str, str], asked: Any, kind: str) -> str:
    if not isinstance(asked, str):
        raise InputError(f"fields must be names, got {asked!r}")
    if asked in known or asked.strip("/") in known:
        return asked if asked in known else asked.strip("/")
    for place, name in known.items():
        if name == asked:
            return place
    raise unknown_name(kind, asked, {*known, *known.values()})


def _distinct(pairs: Iterable[tuple[str, str]]) -> dict[str, str]:
    chosen: dict[str, str] = {}
    for name, place in pairs:
        if chosen.setdefault(name, place) != place:
            raise InputError(
                f"{chosen[name]!r} and {place!r} would both be called {name!r}; name the fields "
                f"with fields={{{name!r}: {chosen[name]!r}, …}}"
            )
    return chosen
