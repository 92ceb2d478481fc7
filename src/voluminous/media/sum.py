"""A sum of media: emissivities and extinctions add."""

from __future__ import annotations

from typing import Any

from ..errors import InputError
from ..expressions.interval import Interval
from .contract import Coefficients, Context, Medium


class Sum(Medium):
    """Several media in the same place.

    Raises
    ------
    InputError
        If they have different numbers of channels.
    """

    def __init__(self, parts: tuple[Medium, ...]) -> None:
        counts = {part.channels for part in parts}
        if len(counts) > 1:
            raise InputError(
                f"media with {' and '.join(map(str, sorted(counts)))} channels cannot be added; "
                "give all of them the same number of colours"
            )
        self.parts = parts
        self.channels = parts[0].channels
        self.grey = all(part.grey for part in parts)
        self.names = tuple(dict.fromkeys(name for part in parts for name in part.names))

    def components(self) -> tuple[Medium, ...]:
        """Return the media this one is the sum of."""
        return self.parts

    def coefficients(self, fields: dict[str, Any], context: Context) -> Coefficients:
        """Return the sums of j and of α."""
        return self._total([part.coefficients(fields, context) for part in self.parts])

    def ranges(self, fields: dict[str, Interval], context: Context) -> Coefficients:
        """Return the sums of the parts' intervals."""
        return self._total([part.ranges(fields, context) for part in self.parts])

    def _total(self, solved: list[Coefficients]) -> Coefficients:
        count = 1 if self.grey else self.channels
        return Coefficients(
            _add([c.emissivity for c in solved]),
            _add([_spread(c.extinction, count) for c in solved]),
        )

    def intensity_unit(self, context: Context) -> Any:
        """Return the unit of the parts' intensity, if they agree."""
        units = {part.intensity_unit(context) for part in self.parts}
        return units.pop() if len(units) == 1 else None

    def key(self) -> Any:
        """Return the keys of all parts."""
        keys = tuple(part.key() for part in self.parts)
        return None if None in keys else keys

    def describe(self) -> dict[str, Any]:
        """Return the parts as plain values."""
        return {"type": "sum", "parts": [part.describe() for part in self.parts]}

    def __repr__(self) -> str:
        return " + ".join(repr(part) for part in self.parts)


def _spread(extinction: list[Any], count: int) -> list[Any]:
    return extinction if len(extinction) == count else extinction * count


def _add(lists: list[list[Any]]) -> list[Any]:
    return [sum(values[1:], values[0]) for values in zip(*lists, strict=True)]
