"""What a derivative or another field is made of that an expression names by a text."""

from __future__ import annotations

import functools
from typing import NamedTuple

from ..errors import ExpressionError
from .expression import Expression
from .parser import parse
from .source import one_line
from .text import text
from .tree import Derivative
from .vectors import Vector


class DerivedField(NamedTuple):
    """A field that is computed from others, with more than their values in the same cell.

    Attributes
    ----------
    name : str
        Its name in `Expression.names`.
    operation : str
        ``gradmag``, ``laplacian``, ``grad.x``, ``grad.y`` or ``grad.z``; ``los``, the component
        away from the observer; or ``along.x`` and the like, the component of a vector that is given
        by others.
    arguments : tuple of Expression
        What is differentiated; or the three components of a vector.
    """

    name: str
    operation: str
    arguments: tuple[Expression, ...]


@functools.lru_cache(maxsize=1024)
def derived_field(name: str) -> DerivedField | None:
    """Return what a name such as ``gradmag(a)`` stands for, however it is written; or None."""
    if "(" not in name:  # most names are identifiers
        return None
    try:
        tree, _ = parse(one_line(name))
    except ExpressionError:
        return None
    if not isinstance(tree, Derivative):
        return None
    argument = tree.argument
    parts = argument.components if isinstance(argument, Vector) else (argument,)
    return DerivedField(tree.name, tree.operation, tuple(Expression(text(p)) for p in parts))


def required_names(expression: Expression) -> tuple[str, ...]:
    """Return the fields and coordinates that an expression needs, those in derivatives too."""
    found: dict[str, None] = {}
    for name in expression.names:
        derived = derived_field(name)
        if derived is None:
            found[name] = None
            continue
        for argument in derived.arguments:
            found |= dict.fromkeys(required_names(argument))
    return tuple(found)
