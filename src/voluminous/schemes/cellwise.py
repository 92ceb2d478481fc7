"""What schemes share whose segments know nothing of each other."""

from __future__ import annotations

from typing import Any

from .contract import Keyed


class Cellwise(Keyed):
    """Carry nothing from one segment to the next: a segment knows its cell."""

    order = 1
    place = "cell"
    linear = True
    controlled = False
    reckoned = False
    coarseness = 0.0

    def start(self, source: Any, walk: Any, track: Any, cursor: Any) -> list[Any]:
        """Carry nothing; see `schemes.contract.Scheme`."""
        return []

    def leapt(
        self, source: Any, walk: Any, track: Any, cursor: Any, carried: list[Any], moved: Any
    ) -> list[Any]:
        """Carry nothing over empty space either."""
        return carried
