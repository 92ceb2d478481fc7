"""The text of an expression: its limits, Python's syntax tree of it, and errors with a caret."""

from __future__ import annotations

import ast
import re
from typing import NoReturn

from ..errors import ExpressionError

MAX_LENGTH = 10_000
MAX_DEPTH = 100

_UNWANTED = {
    "#": "a comment ('#') cannot be part of an expression",
    "\0": "a null byte cannot be part of an expression",
}
# What people used to other languages write, by the character at which Python's parser gives up.
_HINTS = {
    "=": "'=' is not an operator of expressions; '==' compares",
    "&": "'&&' is not an operator of expressions; write 'and'",
    "|": "'||' is not an operator of expressions; write 'or'",
    "!": "'!' is not an operator of expressions; write 'not'",
    "?": "'?' is not an operator of expressions; write where(condition, a, b)",
}
# Two names or numbers with nothing between them: `2 a`, `log10 a`, `v - 5 km`.
_NO_OPERATOR = (
    "an operator or brackets are missing here: write 2*a and log10(a); a number may be followed by "
    "a unit that astropy knows, as in 'v / (5 km/s)'"
)


def one_line(text: str) -> str:
    """Return the text without spaces around it, and with spaces for tabs and line ends."""
    return text.translate(dict.fromkeys(map(ord, "\t\n\r\f\v"), " ")).strip(" ")


def python_tree(text: str) -> ast.expr:
    """Return Python's syntax tree of the text; nothing is compiled.

    Raises
    ------
    ExpressionError
        If the text is empty, too long, nested too deeply, or not an expression.
    """
    _check_text(text)
    try:
        return ast.parse(text, mode="eval").body
    except SyntaxError as error:
        _fail_syntax(text, error)
    except ValueError as error:  # characters that cannot be encoded
        raise ExpressionError(f"the expression cannot be read: {error}") from None
    except (RecursionError, MemoryError):  # how Python's parser reports too deep a nesting
        fail_too_deep(text, 0)


def _check_text(text: str) -> None:
    if not text:
        raise ExpressionError("the expression is empty; write a field name or 'log10(density)'")
    if len(text) > MAX_LENGTH:
        raise ExpressionError(
            f"the expression has {len(text)} characters, expected at most {MAX_LENGTH}; "
            "split it into derived fields"
        )
    for character, problem in _UNWANTED.items():
        if character in text:
            fail(text, text.index(character), problem)


def _fail_syntax(text: str, error: SyntaxError) -> NoReturn:
    # Python counts from 1; 0 stands for the whole text, or its end if that is what is wrong.
    if error.offset:
        place = error.offset - 1
        fail(text, place, _HINTS.get(text[place : place + 1]) or _explained(text, place, error))
    if error.msg == "invalid syntax":
        fail(text, len(text), "the expression ends too early")
    fail(text, 0, error.msg)


def _explained(text: str, place: int, error: SyntaxError) -> str:
    """Return what Python says of an error, or more than that where two operands stand together."""
    before, here = text[:place].rstrip()[-1:], text[place : place + 1]
    beside = (before.isalnum() or before == ")") and here.isalnum()
    # Of 2a Python points to the number.
    return _NO_OPERATOR if beside or "decimal literal" in error.msg else error.msg


def fail_too_deep(text: str, place: int) -> NoReturn:
    """Raise the error for an expression with too many levels."""
    problem = f"nested too deeply: over {MAX_DEPTH} levels, each '+' of a long sum being one"
    fail(text, place, f"{problem}; split it into derived fields")


def fail(text: str, place: int, problem: str) -> NoReturn:
    """Raise the error for a problem at character `place`, with a caret under it.

    Raises
    ------
    ExpressionError
        Always; shows the 100 characters around the place.
    """
    # Units stand in brackets and quotes, see `quantities.marked`.
    before, after = (re.sub(r'\["(.*?)"\]', r" \1", part) for part in (text[:place], text[place:]))
    text, place = before + after, len(before)
    start, end = max(0, place - 50), place + 50
    before, after = "…" * (start > 0), "…" * (end < len(text))
    shown = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text[start:end])
    caret = " " * (len(before) + place - start) + "^"
    raise ExpressionError(f"{problem}\n    {before}{shown}{after}\n    {caret}")
