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
from .tree import Call, Derivative, Field, IntegerPower, Node

AXES = "xyz"


@dataclass(frozen=True, slots=True)
class Vector(Node):
    """Three components and the magnitude; `shown` is the text that is parsed into it."""

    components: tuple[Node, ...]
    magnitude: Node
    shown: str


def derivative(operation: str, argument: Node) -> Derivative:
    """Return the node of ``gradmag``, ``laplacian``, or a component such as ``grad.x``."""
    function, dot, axis = operation.partition(".")
    return Derivative(f"{function}({text(argument)}){dot}{axis}", operation, argument)


def gradient(argument: Node) -> Vector:
    """Return the vector of first derivatives."""
    components = tuple(derivative(f"grad.{axis}", argument) for axis in AXES)
    return Vector(components, derivative("gradmag", argument), f"grad({text(argument)})")


def vector(components: tuple[Node, ...]) -> Vector:
    """Return the vector of three numbers."""
    shown = f"vector({', '.join(text(component) for component in components)})"
    return Vector(components, _length(components), shown)


def named_vector(name: str) -> Vector:
    """Return the vector of the fields ``name_x``, ``name_y`` and ``name_z``."""
    components = tuple(Field(f"{name}_{axis}") for axis in AXES)
    return Vector(components, _length(components), f'"{name}"')


def line_of_sight(whole: Vector) -> Derivative:
    """Return the node of ``los``: a vector's component away from the observer."""
    return Derivative(f"los({whole.shown})", "los", whole)


def _length(components: tuple[Node, ...]) -> Node:
    return Call("sqrt", (_sum(IntegerPower(component, 2) for component in components),))


def dot(left: Vector, right: Vector) -> Node:
    """Return the scalar product."""
    pairs = zip(left.components, right.components, strict=True)
    return _sum(Call("multiply", pair) for pair in pairs)


def _sum(nodes: Iterable[Node]) -> Node:
    return functools.reduce(lambda total, node: Call("add", (total, node)), nodes)
