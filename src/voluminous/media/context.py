"""How media are evaluated, and what they return: coefficients, and the expressions they use."""

from __future__ import annotations

import operator
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np

from ..backend import dr
from ..backend.types import Float
from ..expressions import DrjitOps, Expression, Ops
from ..expressions.drjit_ops import interpolate

if TYPE_CHECKING:
    from .details import Colors

T = TypeVar("T")


class Tape:
    """The run-time numbers that media ask for, one array for each, to differentiate by it.

    A number is known by what asks for it, and by the order in which that does: so equal numbers
    have arrays of their own, and a kernel that is traced again has the same.
    """

    def __init__(self) -> None:
        self.numbers: dict[Hashable, Float] = {}
        self._requests: list[Any] = []

    @property
    def is_counting(self) -> bool:
        """Whether numbers are known by what asks for them; else by their value."""
        return bool(self._requests)

    @contextmanager
    def requests_of(self, key: Hashable) -> Iterator[None]:
        """Count the numbers that are asked for from here."""
        before, self._requests = self._requests, [key, 0]
        yield
        self._requests = before

    def number(self, kind: Any, value: float) -> Float:
        key = (kind, value, *self._requests)
        if self._requests:
            self._requests[1] += 1
        if key not in self.numbers:
            self.numbers[key] = dr.opaque(kind, value)
        return self.numbers[key]


@dataclass
class MediumSample:
    """Emissivity per channel; one extinction for all channels (grey), or one per channel."""

    emissivity: list[Float]
    extinction: list[Float]

    def listed(self) -> list[Float]:
        """Return all values, those of the emissivity first."""
        return [*self.emissivity, *self.extinction]

    @classmethod
    def of(cls, function: Callable[..., Any], *samples: MediumSample) -> MediumSample:
        """Return what a function makes of the values of samples, channel by channel."""
        emissivities = zip(*(s.emissivity for s in samples), strict=True)
        extinctions = zip(*(s.extinction for s in samples), strict=True)
        return cls([function(*v) for v in emissivities], [function(*v) for v in extinctions])


@dataclass
class Halves:
    """Mean coefficients over both halves of a panel, and the error of the mean over the panel."""

    first: MediumSample
    last: MediumSample
    error: MediumSample

    @classmethod
    def of(cls, triples: MediumSample) -> Halves:
        """Return them from (first, last, error) for each value."""
        return cls(*(MediumSample.of(operator.itemgetter(k), triples) for k in range(3)))

    def map(self, function: Callable[[MediumSample], MediumSample]) -> Halves:
        """Return what a function makes of each of the three."""
        return Halves(*map(function, (self.first, self.last, self.error)))


@dataclass(frozen=True)
class Feature:
    """An expression that a medium evaluates.

    `width` is the smallest difference of its values that matters, for example a shell's width; 0 if
    unknown. It decides whether single precision is sufficient along rays. `scalar`: `Medium.means`
    interpolates it linearly and needs no fields inside a panel. `colors`: what shows at its values.
    """

    expr: Expression
    width: Any = 0.0
    scalar: bool = False
    colors: Colors | None = None

    def color_bars(self) -> list[dict[str, Any]]:
        """Return the colour bar, if any, as plain values.

        Values of the expression, and the colours there or the name of a colormap.
        """
        if self.colors is None or self.colors.rows is None:
            return []
        return [{"expr": self.expr.text, **self.colors.describe()}]


@dataclass
class Context:
    """How media are evaluated: number types, run-time data, functions.

    Attributes
    ----------
    real : type
        Dr.Jit float type of the field values and of expressions.
    number : callable
        Turns a Python float into run-time data of that type: changing it never recompiles.
    opaque : callable
        Turns a Python float into run-time data of a given type.
    narrow : callable
        Converts values of `real` to the type of integrals along rays.
    limits : dict of str to (array, array)
        Least and largest values of fields. Interpolated values are clipped to them, since rounding
        beyond them makes logarithms of fields with zeros undefined.
    faint : float
        Coefficients below this fraction of their peak may be neglected.
    tolerance : float
        The error allowed in a pixel, as a fraction of the brightest.
    coordinates : dict of str to Expression
        Formulas of a grid's curvilinear coordinates in x, y and z.
    tape : Tape, optional
        Records the numbers.
    """

    real: Any
    number: Callable[[float], Float]
    opaque: Callable[[Any, float], Float] = dr.opaque
    narrow: Callable[[Float], Float] = lambda value: value
    limits: dict[str, tuple[Float, Float]] = field(default_factory=dict)
    faint: float = 1e-8
    tolerance: float = 1e-3
    coordinates: dict[str, Expression] = field(default_factory=dict)
    tape: Tape | None = None
    _kept: dict[Hashable, Any] = field(default_factory=dict)
    # Whether values are intervals, and are to hold on any ray (`RangeContext`).
    encloses: ClassVar[bool] = False
    on_rays = False

    @property
    def ops(self) -> Ops:
        """The operations and functions to compute with."""
        return DrjitOps(self.real, constant=self.number)

    def keep(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the cached result of `make`, so that run-time numbers enter a kernel once."""
        if key not in self._kept:
            with self.requests_of(key):
                self._kept[key] = make()
        result: T = self._kept[key]
        return result

    def requests_of(self, key: Hashable) -> AbstractContextManager[None]:
        """Context manager in which numbers are known by a key, and by their order."""
        return nullcontext() if self.tape is None else self.tape.requests_of(key)

    def kept_number(self, value: float) -> Float:
        """Return a number as cached run-time data, which enters a kernel once."""
        return self.keep(("number", value), lambda: self.number(value))

    def narrow_number(self, value: float) -> Float:
        """Return a number as run-time data of the type of integrals.

        It is created in that type, not converted: a conversion belongs to the branch of a kernel in
        which it is first requested, but cached values are used in other branches, too.
        """
        number = self.number(value)
        kind = type(self.narrow(number))
        return number if isinstance(number, kind) else self.opaque(kind, value)

    def evaluate(self, expression: Expression, fields: dict[str, Float]) -> Float:
        if self.tape is None or self.tape.is_counting:
            return self.real(expression.evaluate(self.ops, fields))
        with self.tape.requests_of(expression.text):
            return self.real(expression.evaluate(self.ops, fields))

    def interpolate(
        self, x: Float, nodes: np.ndarray, columns: Sequence[np.ndarray]
    ) -> list[Float]:
        """Return the columns of a table, given at its nodes, interpolated at x."""
        return interpolate(self.real, x, nodes, columns)


def completed(ops: Any, fields: dict[str, Any], context: Context) -> dict[str, Any]:
    """Return fields with the coordinates derived from x, y and z, if these are among them."""
    if all(axis in fields for axis in "xyz"):
        x, y, z = (ops.multiply(fields[a], fields[a]) for a in "xyz")
        fields["r"] = ops.sqrt(ops.add(ops.add(x, y), z))
        for name, formula in context.coordinates.items():
            fields[name] = formula.evaluate(ops, fields)
    return fields
