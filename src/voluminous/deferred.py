"""Fields that are read when they are first used."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np

# What sealed arrays are told apart by.
_NUMBERS = itertools.count()


def seal(array: np.ndarray) -> bool:
    """Make an array read-only, and what it is a view of; False if its memory is another's.

    Such as that of a file that is mapped: it changes with the file.
    """
    chain = [array]
    while isinstance(chain[-1].base, np.ndarray):
        chain.append(chain[-1].base)
    root = chain[-1]
    if type(root) is not np.ndarray or not (root.flags.owndata or isinstance(root.base, bytes)):
        return False
    for view in chain:
        view.setflags(write=False)
    return True


@dataclass(frozen=True)
class Deferred:
    """A field that is known, but not read yet: ``volume["density"] = Deferred(read, "f4")``.

    Attributes
    ----------
    load : callable
        Returns the values, as they could be given to the volume.
    dtype : dtype
        What they are.
    unit : str or unit, optional
        Their unit; `load` returns plain numbers.
    mapped : bool
        True if the values stay in the file, and are brought into memory page by page.
    """

    load: Callable[[], Any]
    dtype: Any
    unit: Any = None
    mapped: bool = False


class Fields(MutableMapping[str, np.ndarray]):
    """Arrays by name; those that were deferred are read when they are asked for.

    Arrays that nobody else has are *sealed*: read-only, so that their contents need not be looked
    at to know whether they have changed.
    """

    def __init__(self) -> None:
        self._known: dict[str, np.ndarray | Callable[[], np.ndarray]] = {}
        self._own: set[str] = set()
        self._sealed: dict[str, int] = {}
        self._types: dict[str, np.dtype[Any]] = {}
        self._mapped: set[str] = set()
        self._reading: Callable[[], AbstractContextManager[None]] = nullcontext

    def defer(self, name: str, load: Callable[[], np.ndarray], what: Deferred) -> None:
        """Keep how an array is read, in place of the array."""
        self._known[name], self._types[name] = load, np.dtype(what.dtype)
        (self._mapped.add if what.mapped else self._mapped.discard)(name)
        self._let_go(name)

    def guard(self, reading: Callable[[], AbstractContextManager[None]]) -> None:
        """Read within a context that explains errors."""
        self._reading = reading

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the fields that are not read yet."""
        return tuple(name for name, held in self._known.items() if callable(held))

    def bytes_waiting(self, cells: int) -> int:
        """Return the memory that reading all that is waiting takes."""
        names = [name for name in self.waiting if name not in self._mapped]
        return sum(cells * self._types[name].itemsize for name in names)

    def dtype(self, name: str) -> np.dtype[Any]:
        """Return the type of a field without reading it."""
        return self._types[name]

    def __copy__(self) -> Fields:
        """Return fields of their own: what is read of one is not known to the other."""
        other = Fields()
        other._known, other._types = dict(self._known), dict(self._types)
        other._own, other._sealed = set(self._own), dict(self._sealed)
        other._mapped, other._reading = set(self._mapped), self._reading
        return other

    def __getitem__(self, name: str) -> np.ndarray:
        held = self._known[name]
        if callable(held):
            with self._reading():
                held = held()
            self._known[name], self._types[name] = held, held.dtype
            if name in self._own:
                self.own(name)
        return held

    def __setitem__(self, name: str, array: np.ndarray) -> None:
        self._known[name], self._types[name] = array, array.dtype
        self._let_go(name)

    def __delitem__(self, name: str) -> None:
        del self._known[name], self._types[name]
        self._let_go(name)

    def _let_go(self, name: str) -> None:
        self._own.discard(name)
        self._sealed.pop(name, None)

    def own(self, *names: str) -> None:
        """Say that nobody else has some arrays, or will have them once they are read."""
        for name in names:
            self._own.add(name)
            held = self._known[name]
            if not callable(held) and seal(held):
                self._sealed[name] = next(_NUMBERS)

    def sealed(self, name: str) -> int | None:
        """Return a number that no other array has, if a field cannot change; None if it can."""
        return self._sealed.get(name)

    def __contains__(self, name: object) -> bool:
        return name in self._known  # looking for a name reads nothing

    def __iter__(self) -> Iterator[str]:
        return iter(self._known)

    def __len__(self) -> int:
        return len(self._known)
