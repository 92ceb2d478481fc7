"""What a file of VTK tells of all its data: the time, a title, the unit of lengths."""

from __future__ import annotations

from typing import Any

import numpy as np

from .arrays import encoded
from .attributes import TYPES
from .dataset import told
from .encoded import Encoded, Encoding
from .markup import Element

# More are no remark but data.
_MOST_NUMBERS = 16
_LONGEST_TEXT = 4096


def field_data(coded: Encoding, element: Element | None) -> dict[str, Any]:
    """Return the numbers and texts of ``<FieldData>``, by name."""
    found: dict[str, Any] = {}
    for child in element.children if element is not None else ():
        text = child.attributes.get("type") == "String"
        if not text and child.attributes.get("type") not in TYPES:
            continue
        typed = {**child.attributes, "type": "UInt8"} if text else child.attributes
        array = encoded(coded, Element(child.tag, typed, child.start, text=child.text), "value")
        value = _text(array) if text else _numbers(array)
        if value is not None:
            found[array.name] = value
    return told(found)


def plain_value(values: np.ndarray) -> Any:
    """Return one number, a short list of numbers, or None for more than that."""
    if values.size > _MOST_NUMBERS or values.size == 0:
        return None
    listed = values.reshape(-1).tolist()
    return listed[0] if len(listed) == 1 else listed


def _numbers(array: Encoded) -> Any:
    size = array.size()
    return plain_value(array.values(size)) if 0 < size <= _MOST_NUMBERS else None


def _text(array: Encoded) -> str | None:
    size = array.size()
    if not 0 < size <= _LONGEST_TEXT:
        return None
    data = array.values(size).tobytes()
    return data.decode("utf-8", "replace").rstrip("\0").replace("\0", "\n")
