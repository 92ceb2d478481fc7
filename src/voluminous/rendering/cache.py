"""Statistics of a volume's fields, and the cache of everything computed from them."""

from __future__ import annotations

import threading
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
# Pictures that several threads draw of a volume share its tables.
_TOGETHER = threading.Lock()
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

            def compute() -> tuple[float, float]:
                array = self.volume.array(name)
                return float(array.min()), float(array.max())

            if self.cache is None or not self.is_hashed([name]):
                self._extremes[name] = compute()
            else:
                key = ("extremes", name, self.digest(name))
                self._extremes[name] = self.cache.get_or_make(key, compute)
        return self._extremes[name]

    def range_of(self, name: str) -> Interval:
        """Return the range of a field, or of a coordinate, in the whole volume."""
        if name in self.volume:
            ends = self.extremes(name)
        else:
            ends = coordinate_extremes(self.volume.grid, name)
        return Interval(*(np.asarray(end) for end in ends))


class Cache:
    """Access to `Volume.tables` for one picture.

    The oldest entries are dropped where they exceed `limit` bytes, or memory is short; those that
    this picture uses stay, and do not count.
    """

    limit = 512 << 20

    def __init__(self, volume: Volume) -> None:
        self.volume = volume
        self.statistics = VolumeStatistics(volume, self)
        self._used: set[Hashable] = set()

    def _entry(self, key: Hashable) -> Any:
        with _TOGETHER:
            if (entry := self.volume.tables.get(key)) is not None:
                self._used.add(key)
                self.volume.tables.move_to_end(key)
        return entry

    def get(self, key: Hashable) -> Any:
        entry = self._entry(key)
        return entry and entry[0]

    def put(self, key: Hashable, thing: Made) -> Made:
        """Add an entry; drop the oldest ones if necessary."""
        tables, size = self.volume.tables, max(size_of(thing), _LEAST)
        with _TOGETHER:
            self._used.add(key)
            tables[key] = thing, size
            others = [(old, size) for old, (_, size) in tables.items() if old not in self._used]
            total = sum(size for _, size in others)
            for old, size in others:
                if total <= self.limit and fits(SLABS):
                    break
                del tables[old]
                total -= size
        return thing

    def get_or_make(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """Return the entry of a key, computing it if necessary; always without a key (None)."""
        if key is None:
            return make()
        entry = self._entry(key)
        return self.put(key, make()) if entry is None else entry[0]

    def crossed(self, key: Hashable, steps: float) -> float:
        """Return how many cells the rays of all pictures with a key crossed; None: of this one."""
        total: list[float] = self.get_or_make(key and ("crossed", key), lambda: [0.0])
        total[0] += steps
        return total[0]

    def measurements(self, *exprs: Expression) -> dict[Any, Any]:
        """Return the mutable cache of measurements of expressions, for the current fields."""
        names = dict.fromkeys(name for expr in exprs for name in expr.names)
        texts = [expr.text for expr in exprs]
        return self.get_or_make(("measured", *texts, self.statistics.digests(names)), dict)


# Objects of these packages may hold arrays.
_NAMES = ("rendering", "grids", "expressions", "schemes", "ranges")
_ROOMS = tuple(f"voluminous.{room}" for room in _NAMES)


def size_of(thing: Any, seen: set[int] | None = None) -> int:
    """Return the bytes of all arrays in a thing: in containers and objects of this package."""
    seen = set() if seen is None else seen
    if id(thing) in seen:
        return 0
    seen.add(id(thing))
    parts: Any = ()
    if isinstance(thing, np.ndarray):
        return thing.nbytes
    if isinstance(thing, Volume):
        parts = [thing.array(name) for name in thing.fields if name not in thing.waiting]
    elif isinstance(thing, dr.ArrayBase):
        if dr.depth_v(thing) <= 1:
            return int(dr.width(thing)) * int(dr.itemsize_v(type(thing)))
        parts = thing
    elif isinstance(thing, dict):
        parts = thing.values()
    elif isinstance(thing, (list, tuple)):
        parts = thing
    elif type(thing).__module__.startswith(_ROOMS):
        parts = getattr(thing, "__dict__", {}).values()
    return sum(size_of(part, seen) for part in parts)
