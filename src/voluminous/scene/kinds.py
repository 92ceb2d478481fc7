"""Types of the values in a scene file: validation, and conversion for the constructors."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import InputError, UnitsError, unknown_name
from ..units import quantity_in, split_text


class _UnfitError(Exception):
    """A value is not of the expected kind."""


@dataclass(frozen=True)
class Kind:
    """Expected type of a value: a description, and a converter that may raise `_UnfitError`."""

    expected: str
    take: Callable[[Any], Any]

    def __call__(self, key: str, value: Any) -> Any:
        """Return the value as the constructor expects it."""
        try:
            return self.take(value)
        except _UnfitError:
            raise InputError(f"{key}: expected {self.expected}, got {value!r}") from None
        except UnitsError as error:
            raise UnitsError(f"{key}: {error}") from error


def _of(*types: type) -> Callable[[Any], Any]:
    def take(value: Any) -> Any:
        # bool is a subclass of int in Python, but true is not accepted as a number here.
        if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
            raise _UnfitError
        return value

    return take


def _quantity(value: Any) -> Any:
    if not isinstance(value, str):
        return _number(value)
    found = quantity_in(value)
    if found is None:
        raise _UnfitError
    return found


def _plain_quantity(value: Any) -> Any:
    """Parse an unambiguous quantity; any other text is a name."""
    if not isinstance(value, str):
        return _number(value)
    parts = split_text(value)
    if parts is None or not parts[1][:1].isalpha():  # such as "1.2.840", or "2024-01-01"
        raise _UnfitError
    try:
        return _quantity(value)
    except UnitsError:
        raise _UnfitError from None


def _listed(take: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def take_all(value: Any) -> Any:
        if isinstance(value, list):
            return [take_all(v) for v in value]
        return take(value)

    return take_all


def _either(*takers: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def take(value: Any) -> Any:
        for one in takers:
            try:
                return one(value)
            except _UnfitError:
                continue
        raise _UnfitError

    return take


def _word(word: str) -> Callable[[Any], Any]:
    def take(value: Any) -> Any:
        if value != word:
            raise _UnfitError
        return value

    return take


def _table(take: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def take_table(value: Any) -> Any:
        return {key: take(v) for key, v in _of(dict)(value).items()}

    return take_table


def _nothing(value: Any) -> None:
    """Return None for the text that represents it: TOML has no null value."""
    if value != NONE:
        raise _UnfitError


NONE = "none"
_number, _text, _whole = _of(int, float), _of(str), _of(int)

TEXT = Kind("a text", _text)
BOOLEAN = Kind("true or false", _of(bool))
WHOLE = Kind("a whole number", _whole)
WHOLE_OR_BOOLEAN = Kind("true, false or a whole number", _either(_of(bool), _whole))
WHOLES = Kind("a whole number or a list of them", _listed(_whole))
NUMBER = Kind("a number", _number)
NUMBER_OR_NONE = Kind(f"a number, or {NONE!r}", _either(_nothing, _number))
NUMBERS = Kind("a number or a list of them", _listed(_number))
QUANTITY = Kind("a number, or a text such as '0.1 pc'", _quantity)
QUANTITY_OR_AUTO = Kind(
    "a number, a text such as '0.1 pc', or 'auto'", _either(_word("auto"), _quantity)
)
QUANTITIES = Kind("numbers or texts such as '0.1 pc'", _listed(_quantity))
EXPRESSION = Kind("an expression", _either(_text, _number))
EXPRESSIONS = Kind("an expression, or a list of them", _listed(_either(_text, _number)))
NUMBER_OR_TEXT = Kind("a number or a text", _either(_number, _text))
COLORS = Kind("a name, a number or a list of them", _listed(_either(_text, _number)))
NUMBERS_OR_TEXT = Kind("a text, a number or a list of numbers", _either(_text, _listed(_number)))
FIELDS = Kind(
    "a name, a list of names, or a table name = place", _either(_listed(_text), _table(_text))
)
EXPRESSION_TABLE = Kind("a table name = expression", _table(_either(_text, _number)))
TEXT_TABLE = Kind("a table name = text", _table(_text))
# For keys without a description: texts with units become quantities, other values stay unchanged.
ANYTHING = Kind("a value", _either(_listed(_plain_quantity), lambda value: value))

_ANNOTATED = {"int": WHOLE, "float": NUMBER, "float | None": NUMBER, "bool": BOOLEAN, "str": TEXT}


def or_table(kind: Kind, make: Callable[[dict[str, Any]], Any]) -> Kind:
    """Return a kind that also accepts a table, which `make` converts."""

    def take(value: Any) -> Any:
        return make(value) if isinstance(value, dict) else kind.take(value)

    return Kind(f"{kind.expected}, or a table", take)


def arguments(
    function: Callable[..., Any], section: Mapping[str, Any], kinds: Mapping[str, Kind]
) -> dict[str, Any]:
    """Return a section's values as keyword arguments of the function that it describes.

    Parameters
    ----------
    function : callable
        Its parameters are the allowed keys; those without a default are required.
    section : mapping
        The values, as in the file.
    kinds : mapping of Kind
        Kind of each key; by default it follows from the parameter's annotation.
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
    return {
        key: kinds.get(key, _ANNOTATED.get(str(parameters[key].annotation), ANYTHING))(key, value)
        for key, value in section.items()
    }


def check_keys(section: Mapping[str, Any], known: Any) -> None:
    """Raise an error for the first unknown key; it names the nearest known one."""
    for key in section:
        if key not in known:
            raise unknown_name("key", key, known)
