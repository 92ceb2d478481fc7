"""How media are evaluated, and what they return: coefficients, and the expressions they use."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ..backend import dr
from ..backend.types import Float
from ..expressions import DrjitOps, Expression, Ops
from ..expressions.drjit_ops import interpolate
from ..units import Unit

if TYPE_CHECKING:
    from .color_by import Colors

T = TypeVar("T")


class Tape:
    """The run-time numbers that media ask for, in the order in which they first do.

    One array for each number, so that a result can be differentiated by it. Equal numbers share it.
    """

    def __init__(self) -> None:
        self.numbers: dict[tuple[Any, float], Float] = {}

    def number(self, kind: Any, value: float) -> Float:
        """Return the array of a number."""
        if (kind, value) not in self.numbers:
            self.numbers[kind, value] = dr.opaque(kind, value)
        return self.numbers[kind, value]


@dataclass
class MediumSample:
    """Emissivity per channel; one extinction for all channels (grey), or one per channel."""

    emissivity: list[Float]
    extinction: list[Float]

    def listed(self) -> list[Float]:
        """Return all values, those of the emissivity first."""
        return [*self.emissivity, *self.extinction]


@dataclass
class Halves:
    """Mean coefficients over both halves of a panel, and the error of the mean over the panel."""

    first: MediumSample
    last: MediumSample
    error: MediumSample


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


def no_unit(expression: Expression) -> None:
    """Return None: the unit of an expression is unknown."""


@dataclass
class Context:
    """How a medium is evaluated: number type, run-time constants, units.

    Attributes
    ----------
    real : type
        Dr.Jit float type of the field values and of expressions.
    number : callable
        Turns a Python float into run-time data of that type: changing it never recompiles.
    unit : astropy unit or None
        The volume's length unit.
    unit_of : callable
        Returns the unit of an `Expression`, or None if it has none or is unknown.
    opaque : callable
        Turns a Python float into run-time data of a given type.
    narrow : callable
        Converts values of `real` to the type of integrals along rays.
    scale : float
        The unit of lengths along rays (`Panel.length`), in the volume's unit; `Medium.means` are
        per this length.
    radiance : float or array
        The unit of emission of `Medium.means`; one per channel if the medium is `spectral`.
    limits : dict of str to (array, array)
        Least and largest values of fields. Interpolated values are clipped to them, since rounding
        beyond them makes logarithms of fields with zeros undefined.
    faint : float
        Coefficients below this fraction of their peak may be neglected.
    tolerance : float
        The error allowed in a pixel, as a fraction of the brightest.
    coordinates : dict of str to Expression
        Formulas of a grid's curvilinear coordinates in x, y and z.
    """

    real: Any
    number: Callable[[float], Float]
    unit: Unit
    unit_of: Callable[[Expression], Unit]
    opaque: Callable[[Any, float], Float] = dr.opaque
    narrow: Callable[[Float], Float] = lambda value: value
    scale: float = 1.0
    radiance: Any = 1.0
    limits: dict[str, tuple[Float, Float]] = field(default_factory=dict)
    faint: float = 1e-8
    tolerance: float = 1e-3
    coordinates: dict[str, Expression] = field(default_factory=dict)
    _kept: dict[Hashable, Any] = field(default_factory=dict)

    @property
    def ops(self) -> Ops:
        """The operations and functions to compute with."""
        return DrjitOps(self.real, constant=self.number)

    def keep(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the cached result of `make`, so that run-time numbers enter a kernel once."""
        if key not in self._kept:
            self._kept[key] = make()
        result: T = self._kept[key]
        return result

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
        """Return the value of an expression of the fields."""
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
