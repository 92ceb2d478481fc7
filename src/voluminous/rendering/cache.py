"""Statistics of a volume's fields, and the cache of everything computed from them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ..backend import dr
from ..expressions import Expression
from ..expressions.interval import Interval
from ..fields import coordinate_extremes
from ..memory import fits
from ..volume import Volume

if TYPE_CHECKING:
    from collections.abc import Hashable

Made = TypeVar("Made")
# Maximum bytes of a volume's cache, besides the entries that the current picture uses.
LIMIT = 512 << 20
# Minimum size counted for an entry; limits the number of small ones.
_LEAST = 1 << 18
# Memory left free for temporary arrays while the next entry is computed.
SLABS = 96 << 20


class VolumeStatistics:
    """Least value, largest value and digest of each field: all that planning a picture needs.

    Parameters
    ----------
    volume : Volume
        Contents of fields are hashed once per picture: arrays may have been changed in place.
    cache : Cache, optional
        Remembers them from picture to picture.
    """

    def __init__(self, volume: Volume, cache: Cache | None = None) -> None:
        self.volume, self.cache = volume, cache
        self._digests: dict[str, bytes] = {}
        self._extremes: dict[str, tuple[float, float]] = {}

    def digest(self, name: str) -> bytes:
        """Return a hash of a field's contents."""
        if name not in self._digests:
            self._digests[name] = self.volume.digest(name)
        return self._digests[name]

    def digests(self, names: Iterable[str]) -> tuple[tuple[str, str, bytes], ...]:
        """Return the key of the fields among some names; it includes their units."""
        return tuple(
            (name, str(self.volume.field_unit(name)), self.digest(name))
            for name in names
            if name in self.volume
        )

    def is_hashed(self, names: Iterable[str]) -> bool:
        """Return whether hashes of the fields among some names are free or needed anyway.

        Fields of a volume without any cache entries are not hashed: 1024³ values take a while.
        """
        return bool(self.volume.tables) or all(
            name in self._digests for name in names if name in self.volume
        )

    def extremes(self, name: str) -> tuple[float, float]:
        """Return the least and the largest value of a field; NaN if it has NaN."""
        if name not in self._extremes:
            if self.cache is None or not self.is_hashed([name]):
                self._extremes[name] = self._compute_extremes(name)
            else:
                key = ("extremes", name, self.digest(name))
                self._extremes[name] = self.cache.get_or_make(
                    key, lambda: self._compute_extremes(name)
                )
        return self._extremes[name]

    def _compute_extremes(self, name: str) -> tuple[float, float]:
        array = self.volume.array(name)
        return float(array.min()), float(array.max())

    def range_of(self, name: str) -> Interval:
        """Return the range of a field, or of a coordinate, in the whole volume."""
        if name in self.volume:
            ends = self.extremes(name)
        else:
            ends = coordinate_extremes(self.volume.grid, name)
        return Interval(*(np.asarray(end) for end in ends))


class Cache:
    """Access to `Volume.tables` for one picture.

    The oldest entries are dropped where the total exceeds `LIMIT` bytes, or memory is short; those
    that this picture uses stay.
    """

    def __init__(self, volume: Volume) -> None:
        self.volume = volume
        self.statistics = VolumeStatistics(volume, self)
        self._used: set[Hashable] = set()

    def get(self, key: Hashable) -> Any:
        """Return the entry of a key, or None."""
        if key not in self.volume.tables:
            return None
        self._used.add(key)
        self.volume.tables.move_to_end(key)
        return self.volume.tables[key][0]

    def put(self, key: Hashable, thing: Made) -> Made:
        """Add an entry; drop the oldest ones if necessary."""
        tables = self.volume.tables
        self._used.add(key)
        tables[key] = thing, max(size_of(thing), _LEAST)
        total = sum(size for _, size in tables.values())
        for old, (_, size) in list(tables.items()):
            if total <= LIMIT and fits(SLABS):
                break
            if old not in self._used:
                del tables[old]
                total -= size
        return thing

    def get_or_make(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """Return the entry of a key, computing it if necessary; always without a key (None)."""
        if key is None:
            return make()
        if key not in self.volume.tables:
            return self.put(key, make())
        made: Made = self.get(key)
        return made

    def measurements(self, *exprs: Expression) -> dict[Any, Any]:
        """Return the mutable cache of measurements of expressions, for the current fields."""
        names = dict.fromkeys(name for expr in exprs for name in expr.names)
        texts = [expr.text for expr in exprs]
        return self.get_or_make(("measured", *texts, self.statistics.digests(names)), dict)


def size_of(thing: Any, seen: set[int] | None = None) -> int:
    """Return the bytes of all arrays in a thing: in containers and objects of this package."""
    seen = set() if seen is None else seen
    if id(thing) in seen:
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return thing.nbytes
    if isinstance(thing, dr.ArrayBase):
        return _array_bytes(thing)
    if isinstance(thing, Volume):
        return sum(thing.array(n).nbytes for n in thing.fields if n not in thing.waiting)
    if isinstance(thing, dict):
        return sum(size_of(part, seen) for part in thing.values())
    if isinstance(thing, (list, tuple)):
        return sum(size_of(part, seen) for part in thing)
    own = dataclasses.is_dataclass(thing) or type(thing).__module__.startswith(_ROOMS)
    if own and not isinstance(thing, type):
        return sum(size_of(part, seen) for part in vars(thing).values())
    return 0


# Objects of these packages may hold arrays.
_ROOMS = ("voluminous.rendering", "voluminous.grids")


def _array_bytes(array: Any) -> int:
    kind = type(array)
    if dr.depth_v(kind) > 1:
        return sum(_array_bytes(part) for part in array)
    return int(dr.width(array)) * int(dr.itemsize_v(kind))
