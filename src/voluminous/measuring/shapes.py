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
from ..regions import Box, Cylinder, DoubleCone, Region, Sphere
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


# Of the polygon that a circle is drawn as, which has its area; the radius is true to 1e-4.
_CORNERS = 180


def region_of(text: str) -> Region:
    """Return the region that a text describes.

    Parameters
    ----------
    text : str
        Such as ``"sphere((0, 0, 0), 100 AU) & ~box((-1, -1, 0) pc, (1, 1, 2) pc)"``: the classes
        of `voluminous.regions` in small letters, and ``cone``, one half of a double cone. Units
        follow numbers or points; numbers without are in the volume's unit.

    Raises
    ------
    InputError
        If it cannot be understood; UnknownNameError names the nearest shape or argument.
    """
    reader = ShapeReader(text, "region", _REGIONS)
    return reader.combined(reader.tree())


def polygon_of(text: str, unit: Any) -> np.ndarray:
    """Return the polygon, shape (n, 2), on the image plane that a text describes.

    Parameters
    ----------
    text : str
        ``circle(center, radius)``, ``rectangle(low, high)`` or ``polygon(point, point, …)``, such
        as ``"circle((0, 0), 0.5 pc)"``.
    unit : astropy unit or None
        Of the result, and of numbers without one.

    Raises
    ------
    InputError
        If it cannot be understood; UnknownNameError names the nearest shape or argument.
    """
    reader = ShapeReader(text, "aperture", _APERTURES)
    points = reader.called(reader.tree())
    return np.array([plain(point, unit, "aperture") for point in points(unit)])


def _cone(apex: Any, axis: Any, opening: Any, height: Any = None) -> DoubleCone:
    return DoubleCone(apex, axis, opening, height, side="up")


def _circle(center: Any, radius: Any) -> Callable[[Any], np.ndarray]:
    def points(unit: Any) -> np.ndarray:
        size = plain(radius, unit, "radius")
        if np.ndim(size) or not 0 < size < np.inf:
            raise InputError(f"radius of a circle must be positive, got {radius}")
        step = 2 * np.pi / _CORNERS
        angle = step * np.arange(_CORNERS)
        corner = size * np.sqrt(step / np.sin(step))
        around = corner * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return _plane(center, unit) + around

    return points


def _rectangle(low: Any, high: Any) -> Callable[[Any], np.ndarray]:
    def points(unit: Any) -> np.ndarray:
        (x0, y0), (x1, y1) = _plane(low, unit), _plane(high, unit)
        if not (x0 < x1 and y0 < y1):
            raise InputError(f"low must be below high along both axes, got {low} and {high}")
        return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])

    return points


def _polygon(*points: Any) -> Callable[[Any], np.ndarray]:
    # Points in one pair of parentheses may have one unit.
    given = points[0] if len(points) == 1 and np.ndim(points[0]) else points

    def corners(unit: Any) -> np.ndarray:
        if np.ndim(given[:1]) != 2 or len(given) < 3:
            raise InputError(f"a polygon has three points or more, got {given}")
        return np.array([_plane(point, unit) for point in given])

    return corners


def _plane(point: Any, unit: Any) -> np.ndarray:
    array = np.asarray(plain(point, unit, "point"))
    if array.shape != (2,) or not np.all(np.isfinite(array)):
        raise InputError(f"a point on the image plane is two numbers, got {point}")
    return array


_REGIONS: dict[str, Callable[..., Region]] = {
    "box": Box,
    "sphere": Sphere,
    "cylinder": Cylinder,
    "cone": _cone,
    "doublecone": DoubleCone,
}
_APERTURES = {"circle": _circle, "rectangle": _rectangle, "polygon": _polygon}


# A pixel that a polygon cuts is looked at in so many places along each axis.
_FINE = 16
# Sides of polygons pass through pixels that they touch but for rounding, in pixels.
_SLACK = 1e-6


class Aperture:
    """What counts of an image: all of it (None), a polygon, or a number for each pixel.

    Polygons may be texts, such as ``"circle((0, 0), 0.5 pc)"``; see `polygon_of`.

    Raises
    ------
    InputError
        If it is neither, or has not the image's shape.
    """

    def __init__(self, aperture: Any, frame: Any, unit: Any) -> None:
        self.frame = frame
        shape = frame.pixels[::-1]
        self.polygon: np.ndarray | None = None
        self.counts: np.ndarray | None = None
        if aperture is None:
            return
        if isinstance(aperture, str):
            aperture = polygon_of(aperture, unit)
        array = np.asarray(plain(aperture, unit, "aperture"))
        if array.shape == shape:
            if not np.all((array >= 0) & (array <= 1)):  # nor NaN
                raise InputError("aperture counts from 0 to 1 of each pixel, or is true or false")
            self.counts = array
        elif array.ndim == 2 and array.shape[1] == 2 and len(array) > 2:
            if not np.all(np.isfinite(array)):
                raise InputError("the corners of an aperture must be finite numbers")
            self.polygon = array
        else:
            raise InputError(
                "aperture must be a polygon, shape (n, 2) with n > 2, or have the image's shape "
                f"{shape}, got shape {array.shape}"
            )

    def weights(self) -> np.ndarray:
        """Return what counts of each pixel, shape (ny, nx)."""
        if self.counts is not None:
            return self.counts
        if self.polygon is None:
            return np.ones(self.frame.pixels[::-1])
        return self._covered(self.polygon)

    def _covered(self, polygon: np.ndarray) -> np.ndarray:
        from matplotlib.path import Path

        x, y = np.meshgrid(*self.frame.coordinates())
        outline, size = Path(polygon), np.array(self.frame.pixel)
        centers = np.stack([x, y], axis=-1)
        parts = outline.contains_points(centers.reshape(-1, 2)).reshape(x.shape).astype(float)
        cut = _cut((polygon - centers[0, 0]) / size + 0.5, self.frame.pixels)
        steps = (np.arange(_FINE) + 0.5) / _FINE - 0.5
        within = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) * size
        points = centers[cut][:, None] + within
        inside = outline.contains_points(points.reshape(-1, 2))
        parts[cut] = inside.reshape(-1, _FINE**2).mean(axis=1)
        return parts


def _cut(polygon: np.ndarray, pixels: tuple[int, int]) -> np.ndarray:
    """Return which pixels (ny, nx), of size one from zero on, a polygon's sides pass through."""
    nx, ny = pixels
    (ax, ay), (bx, by) = (part.T[..., None] for part in (polygon, np.roll(polygon, -1, axis=0)))
    row = np.arange(ny)
    # Where a side enters and leaves a row of pixels; a level one is there from end to end.
    low, high = np.minimum(ay, by), np.maximum(ay, by)
    ends = [np.clip(row + side, low, high) for side in (0, 1)]
    rise = np.where(ay == by, 1.0, by - ay)
    place = [
        np.where(ay == by, level, ax + (y - ay) / rise * (bx - ax))
        for level, y in zip((ax, bx), ends, strict=True)
    ]
    there = (low <= row + 1 + _SLACK) & (high >= row - _SLACK)
    first = np.clip(np.floor(np.minimum(*place) - _SLACK), 0, nx).astype(int)
    last = np.clip(np.floor(np.maximum(*place) + _SLACK) + 1, 0, nx).astype(int)
    count, rows = np.zeros((ny, nx + 1), int), np.broadcast_to(row, there.shape)
    np.add.at(count, (rows[there], first[there]), 1)
    np.add.at(count, (rows[there], last[there]), -1)
    return count[:, :nx].cumsum(axis=1) > 0
