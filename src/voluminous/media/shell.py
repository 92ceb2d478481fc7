"""What of a medium is to be seen at some values only: it is missed where none of them is there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .modulation import Modulation


@dataclass(frozen=True)
class Shell:
    """A medium, or one of its levels, that is to be seen at some values of its scalars.

    Attributes
    ----------
    medium : Medium
        The shell alone; it has a `modulation`.
    value : float, str or None
        The value around which it is, as `Medium.describe` tells it; None if it is around none.
    dark : bool
        Whether nothing of it is meant to be seen: it has neither colour nor opacity.
    has_entries : bool
        Whether it was given value by value, as a table is: what is faint is wanted, too. Of a
        profile it is the tail.
    """

    medium: Any
    value: Any
    dark: bool
    has_entries: bool = False

    @property
    def gate(self) -> str | None:
        """The condition under which alone it is there."""
        gate: str | None = self.medium.modulation.gate_key()
        return gate

    def ungated(self) -> Any:
        """Return its medium without that condition."""
        own = self.medium.modulation
        ungated = Modulation(None, own.color, self.medium.channels, own.shade)
        return self.medium.changed(modulation=ungated)
