"""What a function of the fields computes, read as formulas: known as expressions are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..expressions import Expression
from .coefficients import Coefficients
from .context import Context
from .contract import Coefficients as Values
from .contract import Medium

if TYPE_CHECKING:
    from .function import Function


class Formulas(Coefficients):
    """A function as expressions: where it jumps, how smooth it is and what bounds it is known.

    Parameters
    ----------
    function : Function
        Whose they are.
    emissivity, extinction : sequence of Expression
        What it returns, per unit length of the volume: its fields are plain numbers.
    """

    def __init__(
        self,
        function: Function,
        emissivity: tuple[Expression, ...],
        extinction: tuple[Expression, ...],
    ) -> None:
        super().__init__(emissivity, extinction)
        self.function, self.names = function, function.names

    def coefficients(self, fields: dict[str, Any], context: Context) -> Values:
        return Values(
            *([context.evaluate(e, fields) for e in every] for every in self._expressions())
        )

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
    """Return a medium with the formulas of functions in place of these, where they can be read.

    They are read for each picture: what a function closes over may have changed.
    """
    return medium.with_each(lambda part: part.formulas() or part)
