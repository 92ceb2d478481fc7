"""What a medium promises: from field values to emissivity j and extinction α, per unit length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..errors import InputError
from ..expressions import DrjitOps, Expression


@dataclass
class Context:
    """How a medium is evaluated: number type, run-time constants, units.

    Attributes
    ----------
    real : type
        Dr.Jit float type of the field values and of what is computed from them.
    number : callable
        Turns a Python float into run-time data of that type: changing it never compiles again.
    unit : astropy unit or None
        The volume's length unit.
    unit_of : callable
        Returns the unit of an `Expression`, or None where it has none or it is not known.
    """

    real: Any
    number: Callable[[float], Any]
    unit: Any
    unit_of: Callable[[Expression], Any]

    def evaluate(self, expression: Expression, fields: dict[str, Any]) -> Any:
        """Return the value of an expression of the fields."""
        value = expression.evaluate(DrjitOps(self.real, constant=self.number), fields)
        return self.real(value)


@dataclass
class Coefficients:
    """Emissivity per channel; one extinction for all channels (grey), or one per channel."""

    emissivity: list[Any]
    extinction: list[Any]


class Medium:
    """A rule from field values to (j, α); media add with ``+``.

    Attributes
    ----------
    channels : int
        Number of channels of the emissivity.
    grey : bool
        True if one extinction serves all channels.
    names : tuple of str
        The fields and coordinates it looks at.
    """

    channels: int
    grey: bool
    names: tuple[str, ...]

    def coefficients(self, fields: dict[str, Any], context: Context) -> Coefficients:
        """Return j and α per unit length for arrays of field values (traced by Dr.Jit)."""
        raise NotImplementedError

    def key(self) -> Any:
        """Return what identifies this medium, hashable; None if nothing does.

        Tabulated coefficients are used again for a medium with the same key.
        """
        raise NotImplementedError

    def describe(self) -> dict[str, Any]:
        """Return the medium as plain values: what a scene file says of it."""
        raise NotImplementedError

    def components(self) -> tuple[Medium, ...]:
        """Return the media this one is the sum of."""
        return (self,)

    def __add__(self, other: Any) -> Medium:
        from .sum import Sum

        if not isinstance(other, Medium):
            return NotImplemented
        return Sum(self.components() + other.components())

    def __radd__(self, other: Any) -> Medium:
        # sum([...]) starts from 0.
        return self if isinstance(other, int) and other == 0 else NotImplemented

    @staticmethod
    def from_function(
        function: Callable[..., Any],
        fields: Any,
        channels: int,
        *,
        grey: bool = True,
        parameters: dict[str, float] | None = None,
    ) -> Medium:
        """Return a medium from any Python function of the fields; see `media.Function`."""
        from .function import Function

        return Function(function, fields, channels, grey=grey, parameters=parameters)

    def __repr__(self) -> str:
        described = ", ".join(f"{k}={v!r}" for k, v in self.describe().items() if k != "type")
        return f"{type(self).__name__}({described})"


def channel_values(value: Any, what: str) -> tuple[float, ...]:
    """Return finite floats, one per channel, from a number or a sequence.

    Raises
    ------
    InputError
        If they are not numbers.
    """
    import numpy as np

    try:
        values = np.atleast_1d(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be a number or one number per channel, got {value!r}") from error
    if values.ndim != 1 or values.size == 0 or not np.all(np.isfinite(values)):
        raise InputError(f"{what} must be finite, one number per channel, got {value!r}")
    return tuple(float(v) for v in values)


def check_extinction(values: tuple[float, ...], channels: int, what: str) -> None:
    """Refuse negative opacities, and a number of them that is neither one nor the channels'."""
    if min(values) < 0:
        raise InputError(f"{what} must not be negative, got {min(values):g}")
    if len(values) not in (1, channels):
        raise InputError(
            f"{what} must be one number (grey) or {channels} (one per channel), got {len(values)}"
        )
