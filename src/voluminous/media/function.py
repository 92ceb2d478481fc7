"""Media given by Python functions of the fields, and their translation to expressions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, UnitsError
from ..expressions import Expression, without_unit
from ..expressions.symbols import read
from ..units import Unit, parse_unit, unit_name
from .arguments import whole_number
from .bound import Binding
from .coefficients import BoundCoefficients, Coefficients, per_length
from .context import Context, MediumSample
from .contract import Medium
from .sum import with_each

if TYPE_CHECKING:
    from ..evaluation import Evaluation


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

    def bind(self, binding: Binding) -> BoundCoefficients:
        return BoundCoefficients(self, binding, [1.0] * len(self.extinction))

    def emission_unit(self, unit_of: Callable[[Expression], Unit]) -> Unit:
        declared = self.function.units
        return super().emission_unit(unit_of) if declared is None else declared[0]

    def key(self) -> Any:
        return ("Formulas", *(tuple(e.text for e in every) for every in self._expressions()))

    def describe(self) -> dict[str, Any]:
        return self.function.describe()


def with_formulas(medium: Medium) -> Medium:
    """Return a medium with its functions replaced by formulas, where these can be read.

    Functions are read for each picture, because variables in their closures may have changed.
    """

    def read_part(part: Medium) -> Medium:
        return (part.formulas() if isinstance(part, Function) else None) or part

    return with_each(medium, read_part)


_MOST_CHANNELS = 4096
_DECLARE = (
    "{} gets plain numbers in the units of its fields; say what it returns: "
    "from_function(..., units=('erg/(s cm3)', '1/cm')), the units of emissivity and extinction"
)


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
            reason = str(error).strip().partition("\n")[0].rstrip(".")
            raise InputError(
                f"{self.title} fails: {reason}. It is called with arrays that stand for all places "
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
        wanted = (("emissivity", self.channels), ("extinction", 1 if self.grey else self.channels))
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

    def plain(self, volume: Evaluation, emission: Unit = None) -> Medium:
        inputs, units = zip(*(volume.resolved(e) for e in self.inputs), strict=True)
        function = self
        if any(new is not old for new, old in zip(inputs, self.inputs, strict=True)):
            function = self.replace(fields=inputs)
        if self.units is not None:
            return function._in_declared_units(units, volume)
        if all(unit is None for unit in units):
            return function
        formulas = function.formulas()
        try:
            if formulas is not None:
                return formulas.plain(volume)
        except UnitsError as error:
            raise UnitsError(f"{error}; {_DECLARE.format(self.title)}") from error
        raise UnitsError(
            f"{self.title} cannot be read, so the units of what it returns are not known; "
            + _DECLARE.format("it")
        )

    def _in_declared_units(self, units: Sequence[Unit], volume: Evaluation) -> Function:
        emission, extinction = self.units or (None, None)
        factor = per_length(extinction, volume.unit, f"the extinction of {self.title}")
        return self.replace(
            fields=[without_unit(e, u, e.text) for e, u in zip(self.inputs, units, strict=True)],
            function=_Scaled(self.function, factor),
            units=(emission, None),
        )

    def length_unit(self, unit_of: Callable[[Expression], Unit]) -> Unit:
        if self.units is not None:
            return None if self.units[1] is None else self.units[1] ** -1
        formulas = self.formulas()
        return None if formulas is None else formulas.length_unit(unit_of)

    def emission_unit(self, unit_of: Callable[[Expression], Unit]) -> Unit:
        return None if self.units is None else self.units[0]

    def key(self) -> Any:
        return None

    def describe(self) -> dict[str, Any]:
        name = getattr(self.function, "__qualname__", repr(self.function))
        units = {} if self.units is None else {"units": [unit_name(unit) for unit in self.units]}
        return {**super().describe(), "function": name, **units}


class _Scaled:
    """A function whose extinction is multiplied by a number."""

    def __init__(self, function: Any, factor: float) -> None:
        self.function, self.factor = function, factor
        self.__name__ = getattr(function, "__name__", "given")
        self.__qualname__ = getattr(function, "__qualname__", repr(function))

    def __call__(self, *values: Any, **parameters: Any) -> Any:
        result = self.function(*values, **parameters)
        if not isinstance(result, tuple) or len(result) != 2:
            return result  # which is refused
        j, alpha = result
        if isinstance(alpha, (list, tuple)):
            return j, [a * self.factor for a in alpha]
        return j, alpha * self.factor


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
