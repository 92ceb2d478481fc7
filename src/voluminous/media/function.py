"""Media given by Python functions of the fields, and their translation to expressions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..expressions.symbols import read
from ..units import parse_unit, unit_name
from .arguments import whole_number
from .coefficients import Coefficients
from .context import Context, MediumSample
from .contract import Medium
from .sum import with_each


class Formulas(Coefficients):
    """A function as expressions, with known jumps, smoothness and bounds.

    Parameters
    ----------
    function : Function
        The function.
    emissivity, extinction : sequence of Expression
        Its results, per unit length of the volume; its fields are plain numbers.
    """

    def __init__(
        self,
        function: Function,
        emissivity: tuple[Expression, ...],
        extinction: tuple[Expression, ...],
    ) -> None:
        super().__init__(emissivity, extinction)
        self.function, self.names = function, function.names

    def _evaluated(
        self, expressions: Sequence[Expression], fields: dict[str, Any], context: Context
    ) -> MediumSample:
        return self.split([context.evaluate(e, fields) for e in expressions])

    def intensity_unit(self, context: Context) -> Any:
        told = self.function.units is not None
        return self.function.intensity_unit(context) if told else super().intensity_unit(context)

    def key(self) -> Any:
        return ("Formulas", *(tuple(e.text for e in every) for every in self._expressions()))

    def describe(self) -> dict[str, Any]:
        return self.function.describe()

    def _expressions(self) -> tuple[tuple[Expression, ...], tuple[Expression, ...]]:
        return self.emissivity, self.extinction


def with_formulas(medium: Medium) -> Medium:
    """Return a medium with its functions replaced by formulas, where these can be read.

    Functions are read for each picture, because variables in their closures may have changed.
    """
    return with_each(medium, lambda part: part.formulas() or part)


_MOST_CHANNELS = 4096


class Function(Medium):
    """Any function of the fields, written with `voluminous.math` and arithmetic.

    Parameters
    ----------
    function : callable
        Called as ``function(*fields, **parameters)`` with arrays; returns ``(j, α)`` per unit
        length of the volume: `j` a value per channel (or one value), α one value (grey) or one per
        channel. It is called once for all cells: use ``voluminous.math.where`` or ``numpy.where``
        for ``if``.
    fields : sequence of str
        Field names, or expressions of them, in the order of the arguments.
    channels : int
        Number of channels of j.
    grey : bool
        True if the function returns one extinction.
    parameters : dict of float, optional
        Numbers passed to the function as keyword arguments. Changing one never recompiles, while
        changing a number in the function's source does.
    units : (unit, unit), optional
        Of the emissivity and the extinction that it returns for plain numbers in the fields' own
        units, such as ``("erg/(s cm3)", "1/cm")``; None is a plain number, of the extinction per
        unit length of the volume. Needed for fields with units, unless the function can be read,
        and units can be derived for all that it computes.

    Raises
    ------
    InputError
        If the function returns something else or cannot be traced, or a parameter is not a number.

    Notes
    -----
    A function that only uses arithmetic, comparisons, and functions of NumPy or `voluminous.math`
    that expressions also have is read as formulas (`formulas`), which gives its jumps and bounds.
    Any other function is a black box: errors are estimated from its values at the samples of a ray,
    and jumps between them are missed.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        fields: Any,
        channels: int,
        *,
        grey: bool = True,
        parameters: dict[str, float] | None = None,
        units: Any = None,
    ) -> None:
        if not callable(function):
            raise InputError(f"from_function needs a function, got {function!r}")
        if parameters is not None and not isinstance(parameters, Mapping):
            raise InputError(f"parameters must be a dict of names and numbers, got {parameters!r}")
        self.function = function
        self.inputs = tuple(Expression(name) for name in _listed(fields))
        self.channels = whole_number(channels, "channels", 1, _MOST_CHANNELS)
        self.grey = grey
        self.parameters = {name: _number(name, v) for name, v in (parameters or {}).items()}
        self.units = None if units is None else _two_units(units)
        self.names = tuple(dict.fromkeys(n for e in self.inputs for n in e.names))

    def formulas(self) -> Formulas | None:
        """Return the function as expressions; None if it cannot be read.

        It then uses operations that only arrays have; an exception for symbols recurs for arrays.
        """
        try:
            result, expression = read(self.function, self.inputs, self.parameters)
            return Formulas(self, *(tuple(map(expression, v)) for v in self._listed(result)))
        except Exception:  # anybody's function may raise anything
            return None

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        arguments = [context.evaluate(e, fields) for e in self.inputs]
        numbers = {name: context.number(value) for name, value in self.parameters.items()}
        try:
            result = self.function(*arguments, **numbers)
        except (RuntimeError, TypeError) as error:
            told = str(error).strip().partition("\n")[0].rstrip(".")
            raise InputError(
                f"{self.title} fails: {told}. It is called with arrays that stand for all places "
                "at once: use voluminous.math (vm.math.exp, vm.math.where, …) in place of NumPy's "
                "functions and of `if`"
            ) from error
        return MediumSample(*(list(map(context.real, v)) for v in self._listed(result)))

    def _listed(self, result: Any) -> list[list[Any]]:
        if not isinstance(result, tuple) or len(result) != 2:
            raise InputError(
                f"{self.title} must return (emissivity, extinction), got {type(result).__name__}"
            )
        columns = []
        wanted = (("emissivity", self.channels), ("extinction", self.extinction_count))
        for value, (what, count) in zip(result, wanted, strict=True):
            parts = list(value) if isinstance(value, (list, tuple, np.ndarray)) else [value]
            if len(parts) != count:
                raise InputError(
                    f"{self.title} returned {len(parts)} values of {what}, expected {count}"
                )
            columns.append(parts)
        return columns

    @property
    def title(self) -> str:
        """Its name in messages."""
        return f"the function {getattr(self.function, '__name__', 'given')!r} of the medium"

    def intensity_unit(self, context: Context) -> Any:
        unit = None if self.units is None else self.units[0]
        return unit if unit is None or context.unit is None else unit * context.unit

    def key(self) -> Any:
        return None

    def describe(self) -> dict[str, Any]:
        name = getattr(self.function, "__qualname__", repr(self.function))
        units = {} if self.units is None else {"units": [unit_name(unit) for unit in self.units]}
        return {**super().describe(), "function": name, **units}


def _listed(fields: Any) -> tuple[Any, ...]:
    if isinstance(fields, str):
        return (fields,)
    try:
        return tuple(fields) if not isinstance(fields, bytes) else (fields,)
    except TypeError:
        raise InputError(f"fields must be a list of names or expressions, got {fields!r}") from None


def _two_units(units: Any) -> tuple[Any, Any]:
    if not isinstance(units, (list, tuple)) or len(units) != 2:
        raise InputError(
            "units must be that of the emissivity and that of the extinction, such as "
            f"('erg/(s cm3)', '1/cm'), got {units!r}"
        )
    return parse_unit(units[0]), parse_unit(units[1])


def _number(name: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"parameter {name!r} must be a number, got {value!r}") from error
