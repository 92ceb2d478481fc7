"""Building nodes of vectors and derivatives, and what all building needs."""

from __future__ import annotations

import ast
import unicodedata
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NoReturn, cast

from .language import CONSTANTS, FOREIGN, FUNCTIONS
from .source import MAX_LENGTH, fail, one_line, python_tree
from .tree import Derivative, Node
from .vectors import (
    AXES,
    Vector,
    derivative,
    dot,
    gradient,
    line_of_sight,
    named_vector,
    vector,
)

# Levels of sums and products that stand for a product of vectors.
_LEVELS_OF_VECTORS = 3
# Names that are none of vectors.
_NUMBERS = {*CONSTANTS, *FUNCTIONS, "x", "y", "z", "r"}
_A_VECTOR = "grad(density), vector(a, b, c), or the name of one, as in norm(velocity)"


class VectorBuilder(ABC):
    """Turns Python's nodes into ours, and collects the field names on the way."""

    def __init__(self, text: str, depth: int = 0) -> None:
        self._text = text
        self._depth = depth
        self.names: dict[str, None] = {}  # a dict, because it keeps the order

    @abstractmethod
    def build_any(self, node: ast.expr) -> Node:
        """Return our node, a number or a vector, for Python's `node`."""

    def build(self, node: ast.expr) -> Node:
        """Return our node, a number, for Python's `node`."""
        built = self.build_any(node)
        if isinstance(built, Vector):
            self._fail(
                node,
                "this is a vector, but a number is needed here; take a component with .x, .y or "
                ".z, or use norm(v) or dot(v, w)",
            )
        return built

    def _character(self, byte: int) -> int:
        # Python counts in bytes of UTF-8, a caret in characters.
        return len(self._text.encode()[:byte].decode())

    def _fail(self, node: ast.expr, problem: str) -> NoReturn:
        fail(self._text, self._character(node.col_offset), problem)

    def _many(self, nodes: list[ast.expr]) -> tuple[Node, ...]:
        return tuple(self.build(node) for node in nodes)

    def _scalar_derivative(self, node: ast.Call) -> Node:
        operation = cast(ast.Name, node.func).id
        return self._use(derivative(operation, self._differentiated(node)), node)

    def _gradient(self, node: ast.Call) -> Node:
        return gradient(self._differentiated(node))

    def _differentiated(self, node: ast.Call) -> Node:
        argument = node.args[0]
        # A builder of its own: the names in the argument are not names of the expression.
        if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
            quoted = one_line(argument.value)
            return type(self)(quoted, self._depth).build(python_tree(quoted))
        return type(self)(self._text, self._depth).build(argument)

    def _use(self, number: Node, node: ast.expr) -> Node:
        """Return a number made of a vector; only now a derivative is known to be needed."""
        if isinstance(number, Derivative):
            if len(number.name) > MAX_LENGTH:
                self._fail(node, "this derivative is too long; split it into derived fields")
            self.names.setdefault(number.name)
        return number

    def _component(self, node: ast.Attribute) -> Node:
        if not isinstance(node.value, ast.Call) or not isinstance(node.value.func, ast.Name):
            self._fail(node, FOREIGN[ast.Attribute])
        whole = self.build_any(node.value)
        if not isinstance(whole, Vector):
            self._fail(node, f"only a vector has components: {_A_VECTOR}")
        if node.attr not in AXES:
            self._fail(node, f"the components of a vector are .x, .y and .z, not .{node.attr}")
        return self._use(whole.components[AXES.index(node.attr)], node)

    def _vector(self, node: ast.Call) -> Node:
        return vector(self._many(node.args))

    def _norm(self, node: ast.Call) -> Node:
        (argument,) = self._vectors(node)
        return self._use(argument.magnitude, node)

    def _dot(self, node: ast.Call) -> Node:
        left, right = self._vectors(node)
        for component in left.components + right.components:
            self._use(component, node)
        return dot(left, right)

    def _line_of_sight(self, node: ast.Call) -> Node:
        # The fields that the component is made of are not fields of the expression.
        (argument,) = type(self)(self._text, self._depth)._vectors(node)
        return self._use(line_of_sight(argument), node)

    def _vector_argument(self, node: ast.expr) -> Node:
        """Return the node of an argument that may be the name of a vector, also in quotes."""
        if isinstance(node, ast.Name) and node.id not in _NUMBERS:
            name = node.id
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            name = unicodedata.normalize("NFKC", node.value)
        else:
            return self.build_any(node)
        if not name.isidentifier():
            self._fail(node, "quotes hold the name of a vector, as in norm('velocity')")
        self.names |= dict.fromkeys(f"{name}_{axis}" for axis in AXES)
        return named_vector(name)

    def _vectors(self, node: ast.Call) -> list[Vector]:
        self._depth += _LEVELS_OF_VECTORS
        built = [self._vector_argument(argument) for argument in node.args]
        self._depth -= _LEVELS_OF_VECTORS
        for argument, whole in zip(node.args, built, strict=True):
            if not isinstance(whole, Vector):
                self._fail(argument, f"this is a number, but a vector is needed: {_A_VECTOR}")
        return cast(list[Vector], built)


VECTOR_CALLS: dict[str, Callable[[VectorBuilder, Any], Node]] = {
    "gradmag": VectorBuilder._scalar_derivative,
    "laplacian": VectorBuilder._scalar_derivative,
    "grad": VectorBuilder._gradient,
    "vector": VectorBuilder._vector,
    "norm": VectorBuilder._norm,
    "los": VectorBuilder._line_of_sight,
    "dot": VectorBuilder._dot,
}
