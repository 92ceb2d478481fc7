"""What was made of a volume for one picture and serves the next: tables, lattices, blocks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..expressions import Expression
from ..memory import fits
from .coefficients.classify import extremes_of

# Things kept per volume: turning only the camera, or going back and forth between two schemes or
# media, makes nothing again.
_KEPT = 32
# Memory that is left alone: temporary numbers while making the next thing.
SLABS = 96 << 20


class Store:
    """Access to `Volume.tables` for one picture.

    Parameters
    ----------
    volume : Volume
        Its fields' contents are hashed, once per picture, since arrays are not copied
        and may have been changed in place, if others have them.
    """

    def __init__(self, volume: Any) -> None:
        self.volume = volume
        self._digests: dict[str, bytes] = {}
        self._extremes: dict[str, tuple[float, float]] = {}

    def digest(self, name: str) -> bytes:
        """Return a hash of a field's contents."""
        if name not in self._digests:
            self._digests[name] = self.volume.digest(name)
        return self._digests[name]

    def digests(self, names: Any) -> tuple[Any, ...]:
        """Return what identifies the fields among some names: units count too."""
        return tuple(
            (name, str(self.volume.field_unit(name)), self.digest(name))
            for name in names
            if name in self.volume
        )

    def is_hashed(self, names: Any) -> bool:
        """Return whether it costs nothing, or was decided, to hash the fields among some names.

        Where nothing is kept of a volume nothing is hashed either: 1024³ values take a while.
        """
        unknown = [n for n in names if n in self.volume and n not in self._digests]
        return bool(self.volume.tables) or not unknown

    def extremes(self, name: str) -> tuple[float, float]:
        """Return the least and the largest value of a field; NaN if one is."""
        if name not in self._extremes:
            self._extremes[name] = self._find_extremes(name)
        return self._extremes[name]

    def _find_extremes(self, name: str) -> tuple[float, float]:
        if not self.is_hashed([name]):
            return extremes_of(self.volume, name)
        key = ("extremes", name, self.digest(name))
        found: tuple[float, float] = self.kept(key, lambda: extremes_of(self.volume, name))
        return found

    def get(self, key: Any) -> Any:
        """Return what is kept under a key, or None."""
        if key not in self.volume.tables:
            return None
        self.volume.tables.move_to_end(key)
        return self.volume.tables[key]

    def keep(self, key: Any, thing: Any) -> Any:
        """Remember a thing; forget the oldest where there are many, or memory is short."""
        tables = self.volume.tables
        while tables and (len(tables) >= _KEPT or not fits(SLABS)):
            tables.popitem(last=False)
        tables[key] = thing
        return thing

    def known(self, *exprs: Expression) -> dict[Any, Any]:
        """Return what was measured of expressions of the fields as they are, to be added to."""
        names = dict.fromkeys(name for expr in exprs for name in expr.names)
        key = ("measured", *(expr.text for expr in exprs), self.digests(names))
        found: dict[Any, Any] = self.kept(key, dict)
        return found

    def kept(self, key: Any, make: Callable[[], Any]) -> Any:
        """Return what is kept under a key, made if need be."""
        return self.get(key) if key in self.volume.tables else self.keep(key, make())
