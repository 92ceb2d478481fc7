"""Derivatives and vectors: what ``grad(density)`` and its kin become in the tree.

A derivative needs neighbours, which no element-wise evaluation has. It therefore becomes a field
with a name of its own, its text; who has the fields (`Volume`) computes it. Vectors exist only
while parsing: all that is left of them are numbers made of their components.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass

from .text import text
from .tree import Call, Derivative, IntegerPower, Node

AXES = "xyz"


@dataclass(frozen=True, slots=True)
class Vector(Node):
    """Three components, and the magnitude."""

    components: tuple[Node, ...]
    magnitude: Node


def derivative(operation: str, argument: Node) -> Derivative:
    """Return the node of ``gradmag``, ``laplacian``, or a component such as ``grad.x``."""
    function, dot, axis = operation.partition(".")
    return Derivative(f"{function}({text(argument)}){dot}{axis}", operation, argument)


def gradient(argument: Node) -> Vector:
    """Return the vector of first derivatives."""
    components = tuple(derivative(f"grad.{axis}", argument) for axis in AXES)
    return Vector(components, derivative("gradmag", argument))


def vector(components: tuple[Node, ...]) -> Vector:
    """Return the vector of three numbers."""
    squares = (IntegerPower(component, 2) for component in components)
    return Vector(components, Call("sqrt", (_sum(squares),)))


def dot(left: Vector, right: Vector) -> Node:
    """Return the scalar product."""
    pairs = zip(left.components, right.components, strict=True)
    return _sum(Call("multiply", pair) for pair in pairs)


def _sum(nodes: Iterable[Node]) -> Node:
    return functools.reduce(lambda total, node: Call("add", (total, node)), nodes)
