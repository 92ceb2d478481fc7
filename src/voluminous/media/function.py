"""A medium from any Python function of the fields, for physics nobody foresaw."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..errors import InputError
from ..expressions import Expression
from .context import Context
from .contract import Coefficients, Medium


class Function(Medium):
    """Any function of the fields, written with `voluminous.math` and arithmetic.

    Parameters
    ----------
    function : callable
        Called as ``function(*fields, **parameters)`` with arrays; returns ``(j, α)`` per unit
        length of the volume: `j` a value per channel (or one value), α one value (grey) or one per
        channel. It is traced, not called per cell: use ``voluminous.math.where`` for ``if``.
    fields : sequence of str
        Field names, or expressions of them, in the order of the arguments.
    channels : int
        Number of channels of j.
    grey : bool
        True if the function returns one extinction.
    parameters : dict of float, optional
        Numbers given to the function as keyword arguments. Turning one never compiles again, while
        a number written in the function does.

    Raises
    ------
    InputError
        If the function returns something else or cannot be traced, or a parameter is not a number.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        fields: Any,
        channels: int,
        *,
        grey: bool = True,
        parameters: dict[str, float] | None = None,
    ) -> None:
        if not callable(function):
            raise InputError(f"from_function needs a function, got {function!r}")
        if int(channels) != channels or channels < 1:
            raise InputError(f"channels must be a positive whole number, got {channels!r}")
        listed = (fields,) if isinstance(fields, str) else tuple(fields)
        self.function = function
        self.inputs = tuple(Expression(name) for name in listed)
        self.channels = int(channels)
        self.grey = grey
        self.parameters = {name: _number(name, v) for name, v in (parameters or {}).items()}
        self.names = tuple(dict.fromkeys(n for e in self.inputs for n in e.names))

    def coefficients(self, fields: dict[str, Any], context: Context) -> Coefficients:
        """Return j and α as the function gives them."""
        arguments = [context.evaluate(e, fields) for e in self.inputs]
        numbers = {name: context.number(value) for name, value in self.parameters.items()}
        try:
            result = self.function(*arguments, **numbers)
        except (RuntimeError, TypeError) as error:
            told = str(error).strip().partition("\n")[0].rstrip(".")
            raise InputError(
                f"{self._name} fails: {told}. It is called with arrays that stand for all places "
                "at once: use voluminous.math (vm.math.exp, vm.math.where, …) in place of NumPy's "
                "functions and of `if`"
            ) from error
        if not isinstance(result, tuple) or len(result) != 2:
            raise InputError(
                f"{self._name} must return (emissivity, extinction), got {type(result).__name__}"
            )
        count = 1 if self.grey else self.channels
        return Coefficients(
            self._listed(result[0], self.channels, "emissivity", context.real),
            self._listed(result[1], count, "extinction", context.real),
        )

    def _listed(self, value: Any, count: int, what: str, real: Any) -> list[Any]:
        parts = list(value) if isinstance(value, (list, tuple)) else [value]
        if len(parts) != count:
            raise InputError(
                f"{self._name} returned {len(parts)} values of {what}, expected {count}"
            )
        return [real(part) for part in parts]

    @property
    def _name(self) -> str:
        return f"the function {getattr(self.function, '__name__', 'given')!r} of the medium"

    def key(self) -> Any:
        """Return None: what a function closes over may change unseen."""
        return None

    def describe(self) -> dict[str, Any]:
        """Return what can be said of a function."""
        return {
            "type": "function",
            "function": getattr(self.function, "__qualname__", repr(self.function)),
            "fields": [e.text for e in self.inputs],
            "channels": self.channels,
            "parameters": self.parameters,
        }


def _number(name: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"parameter {name!r} must be a number, got {value!r}") from error
