"""Types of the values in a scene file: validation, and conversion for the constructors."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from ..errors import InputError, UnitsError, check_name
from ..units import quantity_in, split_text

# The text for None, which TOML does not have.
NONE = "none"


class _UnfitError(Exception):
    """A value is not of the expected kind."""


@dataclass(frozen=True)
class Kind:
    """Expected type of a value: `expected` in words, `types` accepted as they are.

    With `quantity`, texts are quantities such as "0.1 pc"; with `listed`, lists of such values are
    accepted, of any depth; `words` are texts with a meaning, and what it is; `table` are the types
    of the values in a table, which `make` converts.
    """

    expected: str
    types: tuple[type, ...] = ()
    quantity: bool = False
    listed: bool = False
    words: Mapping[str, Any] = field(default_factory=dict, hash=False)
    table: tuple[type, ...] = ()
    make: Callable[[dict[str, Any]], Any] | None = None

    def __call__(self, key: str, value: Any) -> Any:
        """Return the value as the constructor expects it."""
        try:
            return self._taken(value)
        except _UnfitError:
            raise InputError(f"{key}: expected {self.expected}, got {value!r}") from None
        except UnitsError as error:
            raise UnitsError(f"{key}: {error}") from error

    def _taken(self, value: Any) -> Any:
        if isinstance(value, dict) and self.make is not None:
            return self.make(value)
        is_table = isinstance(value, dict) and bool(self.table)
        if is_table and all(_is_of(self.table, one) for one in value.values()):
            return value
        if isinstance(value, list) and self.listed:
            return [self._taken(one) for one in value]
        if isinstance(value, str) and value in self.words:
            return self.words[value]
        quantity = quantity_in(value) if isinstance(value, str) and self.quantity else None
        if quantity is None and not _is_of(self.types, value):
            raise _UnfitError
        return value if quantity is None else quantity


def _is_of(types: tuple[type, ...], value: Any) -> bool:
    # bool is a subclass of int in Python, but true is not accepted as a number here.
    return isinstance(value, types) and (bool in types or not isinstance(value, bool))


_number, _text = (int, float), (str,)
_either: Any = (*_number, *_text)
TEXT = Kind("a text", _text)
TEXTS = Kind("a text or a list of them", _text, listed=True)
BOOLEAN = Kind("true or false", (bool,))
BOOLEANS = Kind("true, false or a list of them", (bool,), listed=True)
WHOLE = Kind("a whole number", (int,))
WHOLES = Kind("a whole number or a list of them", (int,), listed=True)
WHOLE_OR_AUTO = Kind("a whole number, or 'auto'", (int,), words={"auto": "auto"})
NUMBER = Kind("a number", _number)
NUMBER_OR_NONE = Kind(f"a number, or {NONE!r}", _number, words={NONE: None})
NUMBERS = Kind("a number or a list of them", _number, listed=True)
QUANTITY = Kind("a number, or a text such as '0.1 pc'", _number, quantity=True)
QUANTITY_OR_AUTO = Kind(
    "a number, a text such as '0.1 pc', or 'auto'", _number, quantity=True, words={"auto": "auto"}
)
QUANTITIES = Kind("numbers or texts such as '0.1 pc'", _number, quantity=True, listed=True)
EXPRESSION = Kind("an expression", _either)
EXPRESSIONS = Kind("an expression, or a list of them", _either, listed=True)
NUMBER_OR_TEXT = Kind("a number or a text", _either)
COLORS = Kind("a name, a number or a list of them", _either, listed=True)
NUMBERS_OR_TEXT = Kind("a text, a number or a list of numbers", _either, listed=True)
FIELDS = Kind("a name, a list of names, or a table name = place", _text, listed=True, table=_text)
EXPRESSION_TABLE = Kind("a table name = expression", table=_either)
TEXT_TABLE = Kind("a table name = text", table=_text)

_ANNOTATED = {"int": WHOLE, "float": NUMBER, "float | None": NUMBER, "bool": BOOLEAN, "str": TEXT}


def anything(value: Any) -> Any:
    """Return a value of a key without a kind: unambiguous texts with units become quantities.

    Other texts, such as "1.2.840" or "2024-01-01", are names, and everything stays as it is in a
    list with one of these.
    """

    def taken(one: Any) -> Any:
        if isinstance(one, list):
            return [taken(part) for part in one]
        if not isinstance(one, str):
            return one
        parts = split_text(one)
        if parts is None or not parts[1][:1].isalpha():
            raise _UnfitError
        return quantity_in(one)

    try:
        return taken(value)
    except (_UnfitError, UnitsError):
        return value


def arguments(
    function: Callable[..., Any], section: Mapping[str, Any], kinds: Mapping[str, Kind]
) -> dict[str, Any]:
    """Return a section's values as keyword arguments of the function that it describes.

    The parameters of the function are the allowed keys; those without a default are required. The
    kind of a key, if it is not in `kinds`, follows from the annotation of its parameter.
    """
    parameters = {
        name: parameter
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    }
    check_keys(section, parameters)
    for name, parameter in parameters.items():
        if parameter.default is parameter.empty and name not in section:
            raise InputError(f"{name} is missing; there may be: {', '.join(parameters)}")
        kind = _ANNOTATED.get(str(parameter.annotation))
        kinds = {name: kind, **kinds} if kind is not None else kinds
    return converted(section, kinds)


def converted(section: Mapping[str, Any], kinds: Mapping[str, Kind]) -> dict[str, Any]:
    """Return the values of a section as constructors expect them."""
    return {
        key: kinds[key](key, value) if key in kinds else anything(value)
        for key, value in section.items()
    }


def check_keys(section: Mapping[str, Any], known: Collection[str]) -> None:
    """Raise an error for the first unknown key; it names the nearest known one."""
    for key in section:
        check_name("key", key, known)
