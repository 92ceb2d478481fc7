"""Parts of space, to draw and to measure in: boxes, spheres, half-spaces, …, and combinations.

Lengths are Quantities, or plain numbers in the volume's unit.
"""

from __future__ import annotations

import ast
import functools
import inspect
import operator
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .backend import dr
from .errors import InputError, VoluminousError, unknown_name
from .grids.arguments import on_grid
from .units import Unit, as_given, degrees, described, is_quantity, plain, unit_of
from .value import Value

if TYPE_CHECKING:
    from .backend import Backend
    from .backend.types import Float
    from .grids.contract import Grid, Ray

    # Traced: where a stretch of each ray begins and ends, the wrong way round if there is none.
    Stretch: TypeAlias = tuple[Float, Float]
    Numbers: TypeAlias = Iterator[list[Float]]


# Arguments of regions that are lengths, or places.
_LENGTHS = ("low", "high", "center", "radius", "start", "end", "apex", "height", "point")


class Region(Value):
    """A part of space. Regions combine with ``&`` (both), ``|`` (either) and ``~`` (outside)."""

    # Of which it is made.
    parts: tuple[Region, ...] = ()

    def numbers(self, unit: Unit) -> list[Any]:
        """Return the vectors of numbers, in a unit, that `stretches` takes."""
        return [vector for part in self.parts for vector in part.numbers(unit)]

    def stretches(self, ray: Ray, numbers: Numbers) -> list[Stretch]:
        """Return the stretches of rays inside, in order along the ray (traced).

        Parameters
        ----------
        ray : Ray
        numbers : iterator of lists of arrays
            Those of `numbers`, as run-time data: each region takes its own.
        """
        raise InputError(
            f"{type(self).__name__} can be measured in, but does not tell where rays are inside; "
            "give it methods numbers(unit) and stretches(ray, numbers)"
        )

    def lengths(self) -> Iterator[tuple[str, Any]]:
        """Yield the names and values of its lengths and places."""
        yield from ((n, v) for n, v in vars(self).items() if n in _LENGTHS and v is not None)
        for part in self.parts:
            yield from part.lengths()

    def inside(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        """Return which points are inside.

        Parameters
        ----------
        points : array, shape (3, n)
        unit : astropy unit or None
            Of their coordinates.

        Returns
        -------
        array of bool, shape (n,)
        """
        raise NotImplementedError

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        """Return a lower bound of the distance outside; inside minus one of the depth.

        It finds cells that are larger than a region, or a part of it. Without this method only the
        corners and centres of cells are tested.

        Parameters
        ----------
        points, unit
            See `inside`.

        Returns
        -------
        float64 array, shape (n,)
        """
        return np.full(np.shape(points)[1], np.inf)

    @property
    def bounded(self) -> bool:
        """Whether `beyond` is such a bound everywhere."""
        return bool(self.parts) and all(part.bounded for part in self.parts)

    def __and__(self, other: Region) -> Region:
        return _Combined("&", self, other)

    def __or__(self, other: Region) -> Region:
        return _Combined("|", self, other)

    def __invert__(self) -> Region:
        return Outside(self)

    def describe(self) -> Any:
        """Return it as a text, which `region_of` reads."""
        return str(self)

    def __str__(self) -> str:
        given = {n: getattr(self, n, v) for n, v in self.arguments().items()}
        parts = [_text(v) for n, v in given.items() if n not in ("height", "side")]
        parts += [f"{n}={_text(given[n])}" for n in ("height", "side") if given.get(n) is not None]
        return f"{type(self).__name__.lower()}({', '.join(parts)})"


class _Combined(Region):
    def __init__(self, sign: str, first: Region, second: Region) -> None:
        for part in (first, second):
            if not isinstance(part, Region):
                raise InputError(f"a region combines with another region, got {part!r}")
        self.sign, self.parts = sign, (first, second)
        pairs = {"&": (np.logical_and, np.maximum), "|": (np.logical_or, np.minimum)}
        self.both, self.farther = pairs[sign]

    def stretches(self, ray: Ray, numbers: Numbers) -> list[Stretch]:
        first, second = (part.stretches(ray, numbers) for part in self.parts)
        if self.sign == "|":
            return _joined([*first, *second], len(first) + len(second))
        # In order, because those of both are.
        every = [(dr.maximum(a, c), dr.minimum(b, d)) for a, b in first for c, d in second]
        most = len(first) + len(second) - 1
        return every if len(every) == most else _joined(every, most)

    def inside(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        return np.asarray(self.both(*(part.inside(points, unit) for part in self.parts)))

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        return np.asarray(self.farther(*(part.beyond(points, unit) for part in self.parts)))

    def __str__(self) -> str:
        return f"({f' {self.sign} '.join(map(str, self.parts))})"


class Outside(Region):
    """What is not in a region."""

    def __init__(self, region: Region) -> None:
        self.region, self.parts = region, (region,)

    def __invert__(self) -> Region:
        return self.region

    def stretches(self, ray: Ray, numbers: Numbers) -> list[Stretch]:
        between, end = [], type(ray.direction[0])(-dr.inf)
        for first, last in self.region.stretches(ray, numbers):
            some = first < last  # a stretch of no length is where the one before it ends
            between.append((end, dr.select(some, first, end)))
            end = dr.select(some, last, end)
        return [*between, (end, type(end)(dr.inf))]

    def inside(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        return ~self.region.inside(points, unit)

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        return -self.region.beyond(points, unit)

    def __str__(self) -> str:
        return f"~{self.region}"


class _Solid(Region):
    """Base of regions with a `beyond` of their own."""

    bounded = True

    def inside(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        return self.beyond(points, unit) <= 0.0


class Box(_Solid):
    """What is between two corners.

    Parameters
    ----------
    low, high : three floats or Quantity
    """

    def __init__(self, low: Any, high: Any) -> None:
        self.low, self.high = _point(low, "low"), _point(high, "high")
        if _alike(low, high):  # else it depends on the volume's unit
            self._corners(unit_of(low))

    def _corners(self, unit: Unit) -> tuple[np.ndarray, np.ndarray]:
        low, high = plain(self.low, unit, "low"), plain(self.high, unit, "high")
        if not np.all(low < high):
            raise InputError(
                f"low must be below high along all axes, got {self.low} and {self.high}"
            )
        return low, high

    def numbers(self, unit: Unit) -> list[Any]:
        return [*self._corners(unit)]

    def stretches(self, ray: Ray, numbers: Numbers) -> list[Stretch]:
        axes = zip(ray.origin, ray.direction, next(numbers), next(numbers), strict=True)
        return [functools.reduce(_both, (_between(*axis) for axis in axes))]

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        low, high = (corner[:, None] for corner in self._corners(unit))
        return np.asarray(np.maximum(low - points, points - high).max(axis=0))


class Sphere(_Solid):
    """What is within a distance of a point.

    Parameters
    ----------
    center : three floats or Quantity
    radius : float or Quantity
    """

    def __init__(self, center: Any, radius: Any) -> None:
        self.center, self.radius = _point(center, "center"), _length(radius, "radius")

    def numbers(self, unit: Unit) -> list[Any]:
        return [plain(self.center, unit, "center"), [plain(self.radius, unit, "radius")]]

    def stretches(self, ray: Ray, numbers: Numbers) -> list[Stretch]:
        away = [o - c for o, c in zip(ray.origin, next(numbers), strict=True)]
        return [_within(away, ray.direction, *next(numbers))]

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        away = points - plain(self.center, unit, "center")[:, None]
        return np.asarray(np.linalg.norm(away, axis=0) - plain(self.radius, unit, "radius"))


class HalfSpace(_Solid):
    """What is on the side of a plane to which a vector points.

    Parameters
    ----------
    point : three floats or Quantity
        Of the plane.
    normal : three floats
        Any vector perpendicular to the plane, to the side that is inside.
    """

    def __init__(self, point: Any, normal: Any) -> None:
        self.point, self.normal = _point(point, "point"), _vector(normal, "normal")

    def numbers(self, unit: Unit) -> list[Any]:
        return [plain(self.point, unit, "point"), _unit(self.normal)]

    def stretches(self, ray: Ray, numbers: Numbers) -> list[Stretch]:
        height, rate, *_ = _beside(ray, next(numbers), next(numbers))
        return [_between(height, rate, 0.0, dr.inf)]

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        height, _ = _along(points, plain(self.point, unit, "point"), self.normal)
        return np.asarray(-height)


class Cylinder(_Solid):
    """What is within a distance of a line between two points.

    Parameters
    ----------
    start, end : three floats or Quantity
        The middles of its ends.
    radius : float or Quantity
    """

    def __init__(self, start: Any, end: Any, radius: Any) -> None:
        self.start, self.end = _point(start, "start"), _point(end, "end")
        self.radius = _length(radius, "radius")
        if _alike(start, end):  # else it depends on the volume's unit
            self._ends(unit_of(start))

    def _ends(self, unit: Unit) -> tuple[np.ndarray, np.ndarray]:
        start, end = plain(self.start, unit, "start"), plain(self.end, unit, "end")
        if np.array_equal(start, end):
            raise InputError(f"start and end of a cylinder must differ, got {self.start} twice")
        return start, end

    def numbers(self, unit: Unit) -> list[Any]:
        start, end = self._ends(unit)
        size = float(np.linalg.norm(end - start))
        return [start, (end - start) / size, [size, plain(self.radius, unit, "radius")]]

    def stretches(self, ray: Ray, numbers: Numbers) -> list[Stretch]:
        height, rate, across, pace = _beside(ray, next(numbers), next(numbers))
        size, radius = next(numbers)
        return [_both(_between(height, rate, 0.0, size), _within(across, pace, radius))]

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        start, end = self._ends(unit)
        height, across = _along(points, start, end - start)
        above = np.maximum(-height, height - np.linalg.norm(end - start))
        return np.asarray(np.maximum(above, across - plain(self.radius, unit, "radius")))


class DoubleCone(_Solid):
    """Two cones with one apex: the lobes of an outflow.

    Parameters
    ----------
    apex : three floats or Quantity
    axis : three floats
        Any vector along it.
    opening : float or Quantity
        The angle between axis and surface; plain numbers are degrees.
    height : float or Quantity, optional
        How far each of them goes; by default they never end.
    side : {"both", "up", "down"}
        Both lobes, or the one towards or away from `axis`.
    """

    def __init__(
        self, apex: Any, axis: Any, opening: Any, height: Any = None, side: str = "both"
    ) -> None:
        self.apex, self.axis = _point(apex, "apex"), _vector(axis, "axis")
        self.opening = degrees(opening, "opening")
        self.height = None if height is None else _length(height, "height")
        if not 0 < self.opening <= 90:
            raise InputError(f"opening must be an angle up to 90 degrees, got {opening!r}")
        if side not in ("both", "up", "down"):
            raise InputError(f"side must be 'both', 'up' or 'down', got {side!r}")
        self.side = side

    def numbers(self, unit: Unit) -> list[Any]:
        angle = np.radians(self.opening)
        height = np.inf if self.height is None else plain(self.height, unit, "height")
        sizes = [np.cos(angle), np.sin(angle), height]
        return [plain(self.apex, unit, "apex"), _unit(self.axis), sizes]

    def stretches(self, ray: Ray, numbers: Numbers) -> list[Stretch]:
        height, rate, across, pace = _beside(ray, next(numbers), next(numbers))
        cos, sin, most = next(numbers)
        # Where a t² + 2 b t + c <= 0, in both lobes, with roots that do not cancel.
        a, b, c = (
            cos * cos * _dot(v, w) - sin * sin * x * y
            for v, w, x, y in (
                (pace, pace, rate, rate),
                (across, pace, height, rate),
                (across, across, height, height),
            )
        )
        root = dr.square(b) - a * c
        s = dr.sqrt(dr.maximum(root, 0.0)) + dr.abs(b)
        s = dr.select(b > 0.0, -s, s)
        a = dr.select(a == 0.0, -_TINY, a)
        one, other = s / a, dr.select(s == 0.0, 0.0, c / s)
        first, last, never = dr.minimum(one, other), dr.maximum(one, other), type(a)(dr.inf)

        def lobe(sign: float) -> Stretch:
            up, h = sign * rate > 0.0, sign * height
            narrow = (a > 0.0) & (root > 0.0) & (h - sign * rate * b / a > 0.0)
            begin = dr.select(narrow, first, dr.select(up, last, -never))
            end = dr.select(narrow, last, dr.select(up, never, first))
            begin = dr.select(narrow | (a < 0.0), begin, never)
            return _both((begin, end), _between(h, sign * rate, 0.0, most))

        if self.side != "both":
            return [lobe(1.0 if self.side == "up" else -1.0)]
        return _joined([lobe(1.0), lobe(-1.0)], 2)

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        height, across = _along(points, plain(self.apex, unit, "apex"), self.axis)
        height = {"both": np.abs(height), "up": height, "down": -height}[self.side]
        angle = np.radians(self.opening)
        beyond = across * np.cos(angle) - height * np.sin(angle)
        if self.height is not None:
            beyond = np.maximum(beyond, height - plain(self.height, unit, "height"))
        return np.asarray(beyond)


# Traced: where rays are inside. Each stretch is another loop in the kernel.
_TINY, _MOST = 1e-37, 8


def _dot(a: list[Float], b: list[Float]) -> Float:
    return dr.fma(a[0], b[0], dr.fma(a[1], b[1], a[2] * b[2]))


def _beside(ray: Ray, point: list[Float], axis: list[Float]) -> tuple[Any, ...]:
    """Return origins and directions seen from a point: along an axis, and across it."""
    away = [o - p for o, p in zip(ray.origin, point, strict=True)]
    height, rate = _dot(away, axis), _dot(ray.direction, axis)
    across, pace = (
        [v - part * n for v, n in zip(vector, axis, strict=True)]
        for vector, part in ((away, height), (ray.direction, rate))
    )
    return height, rate, across, pace


def _both(first: Stretch, second: Stretch) -> Stretch:
    return dr.maximum(first[0], second[0]), dr.minimum(first[1], second[1])


def _between(place: Float, rate: Float, low: Any, high: Any) -> Stretch:
    """Return where a coordinate that grows along rays is between two numbers."""
    flat, inside = rate == 0.0, (place >= low) & (place <= high)
    per = 1.0 / dr.select(flat, 1.0, rate)
    one, other = (low - place) * per, (high - place) * per
    end = dr.select(inside, type(rate)(dr.inf), -dr.inf)
    return (
        dr.select(flat, -end, dr.minimum(one, other)),
        dr.select(flat, end, dr.maximum(one, other)),
    )


def _within(away: list[Float], pace: list[Float], radius: Float) -> Stretch:
    """Return where ``away + t pace`` is no longer than a radius, from where it is shortest."""
    away, pace = ([c / radius for c in vector] for vector in (away, pace))
    square = _dot(pace, pace)
    still = square == 0.0
    square = dr.select(still, 1.0, square)
    middle = -_dot(away, pace) / square
    nearest = [dr.fma(middle, p, a) for a, p in zip(away, pace, strict=True)]
    left = 1.0 - _dot(nearest, nearest)
    half = dr.select(still, dr.inf, dr.sqrt(dr.maximum(left, 0.0) / square))
    half = dr.select(left < 0.0, -1.0, half)  # the wrong way round
    return middle - half, middle + half


def _joined(every: list[Stretch], most: int) -> list[Stretch]:
    """Return at most so many stretches, in order, that cover those of a list."""
    if most > _MOST:
        raise InputError(
            f"a ray may be inside a clip in {_MOST} stretches at most, and here in {most}: combine "
            "fewer regions, or have a field that is zero outside, volume['inside'] = …"
        )
    end, joined = type(every[0][0])(-dr.inf), []
    for _ in range(most):
        begin = type(end)(dr.inf)
        for first, last in every:
            some = (first < last) & (last > end)
            begin = dr.minimum(begin, dr.select(some, first, dr.inf))
        end = begin
        for first, last in every * len(every):
            end = dr.select((first < last) & (first <= end), dr.maximum(end, last), end)
        joined.append((begin, end))
    return joined


class Clip:
    """A region as limits of rays; its numbers are run-time data of kernels.

    Attributes
    ----------
    form : str
        What decides how it is traced.
    numbers : list of lists of float
        In the unit of the grid.
    """

    def __init__(self, clip: Region | str, grid: Grid) -> None:
        self.region = region = region_on(clip, grid)
        self.form = _NUMBERS.sub("", str(region))
        self.numbers = [list(map(float, vector)) for vector in region.numbers(grid.unit)]

    def traced(self, backend: Backend) -> list[list[Float]]:
        """Return its numbers as run-time data."""
        return [[backend.wide(c) for c in vector] for vector in self.numbers]

    def cut(self, ray: Ray, numbers: list[list[Float]]) -> Ray:
        """Return rays that end where they leave the region, of which there may be several parts."""
        first, *others = stretches = self.region.stretches(ray, iter(numbers))
        return replace(ray, stretches=stretches) if others else ray.confined(*first)


def region_on(given: Any, grid: Grid) -> Region:
    """Return a region, or that of a text, before a grid.

    Plain numbers that were meant in another unit are refused; see `on_grid`.
    """
    region = region_of(given) if isinstance(given, str) else given
    if not isinstance(region, Region):
        raise InputError(
            "clip must be one of vm.regions, such as Box(low, high), or a text such as "
            f"'box((0, 0, 0), (1, 1, 1))', got {given!r}"
        )
    for name, value in region.lengths():
        on_grid(value, grid, name, across=name in ("radius", "height", "slab"))
    return region


def _along(points: np.ndarray, origin: np.ndarray, axis: np.ndarray) -> tuple[Any, Any]:
    away, axis = points - origin[:, None], _unit(axis)
    height = axis @ away
    return height, np.linalg.norm(away - axis[:, None] * height, axis=0)


def _alike(first: Any, second: Any) -> bool:
    return (unit_of(first) is None) == (unit_of(second) is None)


def _point(value: Any, what: str) -> Any:
    unit = unit_of(value)
    array = np.asarray(plain(value, unit, what))
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be three finite numbers, got {value!r}")
    return array if unit is None else array * unit


def _vector(value: Any, what: str) -> np.ndarray:
    vector = plain(_point(value, what), None, what)
    if not np.any(vector):
        raise InputError(f"{what} must be a vector that is not zero")
    return np.asarray(vector)


def _unit(vector: np.ndarray) -> np.ndarray:
    vector = vector / np.abs(vector).max()  # squares of tiny and huge numbers are 0 and inf
    return np.asarray(vector / np.linalg.norm(vector))


def _length(value: Any, what: str) -> Any:
    value = as_given(value, what)
    number = plain(value, unit_of(value), what)
    if np.ndim(number) or not 0 < number < np.inf:
        raise InputError(f"{what} must be positive, got {value!r}")
    return value if is_quantity(value) else number


def _text(value: Any) -> str:
    value = described(value)
    if isinstance(value, list):
        return f"({', '.join(map(_text, value))})"
    return value if isinstance(value, str) else repr(value).removesuffix(".0")


# --- texts ----------------------------------------------------------------------------------------

_LONGEST, _SHOWN = 10_000, 80
# A name that may be a unit, and a number with one; the unit after a point is that of its numbers.
_UNIT = r"\s*\*?\s*(?!(?:and|or|not|if|else)\b|e[-+]?\d)([^\W\d]\w*)"
_NUMBER = re.compile(r"(?<![\w.'\"])(-?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)" + _UNIT, re.IGNORECASE)
_POINT = re.compile(r"\(([^()]*)\)" + _UNIT)
# The numbers of a region's text, with their units.
_NUMBERS = re.compile(r"(?<![\w.])-?(?:\d|inf)[^,()]*")
_UNREADABLE = (SyntaxError, ValueError, TypeError, RecursionError, MemoryError, VoluminousError)


def read_shape(text: str, what: str, shapes: Mapping[str, Callable[..., Any]]) -> Any:
    """Return the shape that a text describes: calls of known names with literal values.

    Shapes are combined by ``&``, ``|`` and ``~``, or by ``and``, ``or`` and ``not``. Only Python's
    grammar is used: nothing is evaluated.
    """

    def shape(node: ast.expr) -> Any:
        match node:
            case ast.UnaryOp(op=ast.Invert() | ast.Not(), operand=part):
                return ~shape(part)
            case ast.BinOp(left=left, op=ast.BitAnd(), right=right):
                return shape(left) & shape(right)
            case ast.BinOp(left=left, op=ast.BitOr(), right=right):
                return shape(left) | shape(right)
            case ast.BoolOp(op=op, values=parts):
                rule = operator.and_ if isinstance(op, ast.And) else operator.or_
                return functools.reduce(rule, map(shape, parts))
            case ast.Call(func=ast.Name(id=name), args=args, keywords=keywords):
                make = shapes.get(name.lower().replace("_", ""))
                if make is None:
                    raise unknown_name(what, name, shapes)
                known = inspect.signature(make).parameters
                for keyword in keywords:
                    if keyword.arg not in known:
                        raise unknown_name("argument", str(keyword.arg), known)
                return make(*map(_value, args), **{str(k.arg): _value(k.value) for k in keywords})
        raise ValueError("expected shapes, combined by &, | and ~")

    def with_unit(point: re.Match[str]) -> str:
        return f"({','.join(f'{number} {point[2]}' for number in point[1].split(','))})"

    try:
        if len(text) > _LONGEST:
            raise ValueError(f"it has {len(text)} characters, expected {_LONGEST} at most")
        quoted = _NUMBER.sub(r"'\1 \2'", _POINT.sub(with_unit, " ".join(text.split())))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # the error suffices
            return shape(ast.parse(quoted, mode="eval").body)
    except _UNREADABLE as error:
        shown = text if len(text) <= _SHOWN else text[:_SHOWN] + "…"
        known = ", ".join(
            f"{name}({', '.join(inspect.signature(make).parameters)})"
            for name, make in shapes.items()
        )
        kind = type(error) if isinstance(error, VoluminousError) else InputError
        reason = str(getattr(error, "msg", error)).replace(".__init__()", "")
        raise kind(
            f"{what} {shown!r}: {reason or 'too long'}; points are in parentheses: (0, 0, 0); "
            f"there are: {known}"
        ) from None


def _value(node: ast.expr) -> Any:
    """Return a word, a number, a text such as '0.5 pc', or a tuple of these."""
    try:
        return node.id if isinstance(node, ast.Name) else ast.literal_eval(node)
    except ValueError:
        shown = ast.unparse(node)
        raise ValueError(f"expected a number, a length or a point, got {shown}") from None


def _cone(apex: Any, axis: Any, opening: Any, height: Any = None) -> DoubleCone:
    return DoubleCone(apex, axis, opening, height, side="up")


_REGIONS: dict[str, Callable[..., Region]] = {
    "box": Box,
    "sphere": Sphere,
    "cylinder": Cylinder,
    "halfspace": HalfSpace,
    "cone": _cone,
    "doublecone": DoubleCone,
}


def region_of(text: str) -> Region:
    """Return the region that a text describes; numbers without a unit are in the volume's.

    Such as ``"sphere((0, 0, 0), 100 AU) & ~box((-1, -1, 0), (1, 1, 2 pc))"``: the classes of
    `voluminous.regions` in small letters, and ``cone``, one half of a double cone.
    """
    region: Region = read_shape(text, "region", _REGIONS)
    return region
