"""What to give for a raw file of which too little is known."""

from __future__ import annotations

import math

from .told import Told

_NAMES = {1: "uint8", 2: "int16 or uint16", 4: "float32", 8: "float64"}


def what_to_give(told: Told, size: int | None, header: str) -> str:
    """Return a message.

    Parameters
    ----------
    told : Told
        What is known.
    size : int or None
        Bytes of values, if known.
    header : str
        A header of another format beside the file; empty if there is none.
    """
    if header:
        return f"open {header} beside it, which says what is in it; or give shape and dtype"
    missing = " and ".join(n for n in ("shape", "dtype") if getattr(told, n) is None)
    text = (
        f"bare numbers, and nothing tells their {missing}; give shape=(nx, ny, nz) and "
        "dtype='uint8' (or 'int16', 'float32' …)"
    )
    if size is None:
        return text
    return f"{text}. {size} bytes could be {_guesses(size, told) or 'no cube of any type'}"


def _guesses(size: int, told: Told) -> str:
    found = []
    for width, name in _NAMES.items():
        count = size // width
        side = round(count ** (1 / 3))
        if size % width or (told.dtype is not None and told.dtype.itemsize != width):
            continue
        if told.shape is not None and math.prod(told.shape) == count:
            found.append(name)
        if told.shape is None and side and side**3 == count:
            found.append(f"{side} x {side} x {side} of {name}")
    return ", or ".join(found)
