"""What the attributes of XML elements say: numbers, lists of numbers, types."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import FileFormatError
from .markup import Element

TYPES = {
    "Int8": "i1",
    "UInt8": "u1",
    "Int16": "i2",
    "UInt16": "u2",
    "Int32": "i4",
    "UInt32": "u4",
    "Int64": "i8",
    "UInt64": "u8",
    "Float32": "f4",
    "Float64": "f8",
}
# Whole numbers in attributes: indices, counts and places in files.
_LARGEST = 2**62


def whole(element: Element, name: str, count: int) -> tuple[int, ...]:
    """Return an attribute of so many whole numbers.

    Raises
    ------
    FileFormatError
        If it is another.
    """
    try:
        numbers = tuple(int(word) for word in element.attributes[name].split())
    except (KeyError, ValueError):
        numbers = ()
    if len(numbers) != count or any(abs(n) > _LARGEST for n in numbers):
        raise FileFormatError(
            f"<{element.tag}>: expected {name} to be {count} whole numbers, got "
            f"{element.attributes.get(name)!r:.100}"
        )
    return numbers


def real(element: Element, name: str, default: Any) -> tuple[float, ...]:
    """Return an attribute of as many numbers as the default has; the default if there is none.

    Raises
    ------
    FileFormatError
        If it is another.
    """
    text = element.attributes.get(name)
    if text is None:
        return tuple(default)
    try:
        numbers = tuple(float(word) for word in text.split())
    except ValueError:
        numbers = ()
    if len(numbers) != len(default) or not np.isfinite(numbers).all():
        raise FileFormatError(
            f"<{element.tag}>: expected {name} to be {len(default)} finite numbers, got "
            f"{text!r:.100}"
        )
    return numbers


def value_type(element: Element) -> np.dtype[Any]:
    """Return the type of an array's values."""
    return np.dtype(one_of(element, "type", TYPES, None))


def one_of(element: Element, name: str, known: dict[str, Any], default: Any) -> Any:
    """Return what one of several words in an attribute stands for.

    Raises
    ------
    FileFormatError
        If there is another word, or none and no default.
    """
    text = element.attributes.get(name)
    if text is None and default is not None:
        return default
    if text not in known:
        raise FileFormatError(
            f"<{element.tag}>: expected {name} to be one of {', '.join(known)}, got {text!r:.100}"
        )
    return known[text]
