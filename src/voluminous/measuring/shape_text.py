"""Shapes as texts, such as ``sphere((0, 0, 0), 100 AU)``: calls of known names with plain values.

Python's grammar is all that is used of Python: nothing is evaluated.
"""

from __future__ import annotations

import ast
import inspect
import re
import warnings
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

import numpy as np

from ..errors import InputError, unknown_name
from ..io.guard import placed
from ..units import is_quantity, parse_unit, plain

_MOST, _DEEPEST, _SHOWN = 10_000, 100, 80
# A number or a closed parenthesis, and what looks like its unit.
_WITH_UNIT = re.compile(
    r"((?<![\w.])(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|\))\s*"
    r"(?!(?:and|or|not|if|else)\b|[eE][-+]?\d)([^\W\d]\w*)"
)


class ShapeReader:
    """Reads one text.

    Parameters
    ----------
    text : str
        What a user wrote.
    what : str
        What it is, for messages.
    shapes : mapping of callables
        Known names, in small letters without underscores, and what they call.
    """

    def __init__(self, text: str, what: str, shapes: Mapping[str, Callable[..., Any]]) -> None:
        self.text, self.what, self.shapes = " ".join(text.split()), what, shapes

    def tree(self) -> ast.expr:
        """Return Python's syntax tree; a unit is what a value is multiplied with.

        Raises
        ------
        InputError
            If it is not in Python's grammar.
        """
        if not self.text or len(self.text) > _MOST:
            self.fail(f"it has {len(self.text)} characters, expected 1 to {_MOST}")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", SyntaxWarning)  # errors say what is wrong
                tree = ast.parse(_WITH_UNIT.sub(r"\1*\2", self.text), mode="eval").body
        except SyntaxError as error:
            self.fail(error.msg)
        except (ValueError, RecursionError, MemoryError):  # how Python's parser gives up
            self.fail("it cannot be read")
        self._check_depth(tree)
        return tree

    def _check_depth(self, tree: ast.expr) -> None:
        nodes: list[ast.AST] = [tree]
        level = 0
        while nodes:
            nodes = [child for node in nodes for child in ast.iter_child_nodes(node)]
            level += 1
            if level > _DEEPEST:
                self.fail(f"it is nested too deeply, over {_DEEPEST} levels")

    def fail(self, problem: str) -> NoReturn:
        """Raise the error that names the text."""
        shown = self.text if len(self.text) <= _SHOWN else self.text[:_SHOWN] + "…"
        raise InputError(f"{self.what} {shown!r}: {problem}; there are: {self.known()}")

    def known(self) -> str:
        """Return how all shapes are called."""
        return ", ".join(map(self._signature, self.shapes))

    def combined(self, node: ast.expr) -> Any:
        """Return shapes combined by ``&``, ``|`` and ``~``, or by ``and``, ``or`` and ``not``."""
        both, either = (ast.BitAnd, ast.And), (ast.BitOr, ast.Or)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Invert, ast.Not)):
            return ~self.combined(node.operand)
        if isinstance(node, ast.BinOp) and isinstance(node.op, (*both, *either)):
            parts = [self.combined(part) for part in (node.left, node.right)]
        elif isinstance(node, ast.BoolOp):
            parts = [self.combined(part) for part in node.values]
        elif isinstance(node, ast.Call):
            return self.called(node)
        else:
            self.fail(f"expected shapes, combined by &, | and ~; got {_told(node)}")
        first, *others = parts
        for other in others:
            first = first & other if isinstance(node.op, both) else first | other
        return first

    def called(self, node: ast.expr) -> Any:
        """Return the shape that a call describes.

        Raises
        ------
        UnknownNameError
            For a name that is no shape, or no argument of it; names the nearest.
        InputError
            If arguments are missing, too many, or do not make sense.
        """
        if not isinstance(node, ast.Call):
            self.fail(f"expected a shape, got {_told(node)}")
        name = _told(node.func).lower().replace("_", "")
        if name not in self.shapes:
            raise unknown_name(self.what, _told(node.func), self.shapes)
        parameters = inspect.signature(self.shapes[name]).parameters
        for key in (keyword.arg for keyword in node.keywords):
            if key is None:
                self.fail(f"expected NAME=VALUE, got {_told(node)}")
            if key not in parameters:
                with placed(self._signature(name)):
                    raise unknown_name("argument", key, parameters)
        values = [self.value(part) for part in node.args]
        named = {str(part.arg): self.value(part.value) for part in node.keywords}
        try:
            inspect.signature(self.shapes[name]).bind(*values, **named)
        except TypeError as error:
            told = f"{self._signature(name)}: {error} in {_told(node)}"
            raise InputError(f"{told}; points are in parentheses: (0, 0, 0)") from None
        with placed(_told(node)):
            return self.shapes[name](*values, **named)

    def value(self, node: ast.expr) -> Any:
        """Return a number, a quantity, a word, or a tuple of these."""
        if isinstance(node, (ast.Tuple, ast.List)):
            return self._sequence([self.value(part) for part in node.elts], node)
        if isinstance(node, ast.Constant) and type(node.value) in (int, float, str):
            return node.value if isinstance(node.value, str) else self._number(node)
        if isinstance(node, ast.Name):
            return node.id
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.UAdd)):
            number = self.value(node.operand)
            if not isinstance(number, (str, tuple)):
                return -number if isinstance(node.op, ast.USub) else number
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
            number = self.value(node.left)
            if isinstance(node.right, ast.Name) and isinstance(number, (float, tuple)):
                unit = parse_unit(node.right.id)
                return number if unit is None else self._array(number, node) * unit
        self.fail(f"expected a number, with or without a unit, or a point, got {_told(node)}")

    def _sequence(self, parts: list[Any], node: ast.expr) -> Any:
        units = [part.unit for part in parts if is_quantity(part)]
        if not units:
            return tuple(parts)
        if any(isinstance(part, str) or (not is_quantity(part) and np.any(part)) for part in parts):
            self.fail(f"give all numbers of {_told(node)} a unit, or all of it: (1, 2, 3) pc")
        numbers = [plain(part, units[0], "value") for part in parts]
        return self._array(numbers, node) * units[0]

    def _number(self, node: ast.Constant) -> float:
        try:
            return float(node.value)  # type: ignore[arg-type]
        except OverflowError:
            self.fail(f"{_told(node)} is larger than double precision can hold")

    def _array(self, numbers: Any, node: ast.expr) -> np.ndarray:
        try:
            return np.asarray(numbers, dtype=np.float64)
        except ValueError:
            self.fail(f"expected numbers, or points of as many each, got {_told(node)}")

    def _signature(self, name: str) -> str:
        told = []
        for key, parameter in inspect.signature(self.shapes[name]).parameters.items():
            given = parameter.default is not parameter.empty and parameter.default is not None
            star = "*" if parameter.kind is parameter.VAR_POSITIONAL else ""
            told.append(f"{star}{key}={parameter.default}" if given else star + key)
        return f"{name}({', '.join(told)})"


def _told(node: ast.AST) -> str:
    text = re.sub(r"(?<=[\d)])\s*\*\s*(?=[^\W\d])", " ", ast.unparse(node))
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "…"
