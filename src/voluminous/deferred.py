"""Fields that are read when they are first used."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

# Each sealed array gets another number.
_NUMBERS = itertools.count()


def seal(array: np.ndarray) -> bool:
    """Make an array and its bases read-only; False if it does not own its memory.

    The memory of a mapped file, for example, changes with the file.
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
    """A field that is not read yet: ``volume["density"] = Deferred(read, "f4")``.

    Attributes
    ----------
    load : callable
        Returns the values as plain numbers.
    dtype : dtype
    unit : str or unit, optional
    mapped : bool
        True if the values stay in the file, and are brought into memory page by page.
    """

    load: Callable[[], Any]
    dtype: Any
    unit: Any = None
    mapped: bool = False


@dataclass
class _Field:
    """One array, or how it is read; `sealed` is its number if it cannot change."""

    dtype: np.dtype[Any]
    array: np.ndarray | None = None
    load: Callable[[], np.ndarray] | None = None
    mapped: bool = False
    owned: bool = False
    sealed: int | None = None

    def own(self) -> None:
        self.owned = True
        if self.array is not None and seal(self.array):
            self.sealed = next(_NUMBERS)


class Fields(MutableMapping[str, np.ndarray]):
    """Arrays by name; deferred ones are read at first use.

    Arrays that no other code holds are *sealed*: read-only, so that their contents need not be
    hashed to know whether they have changed.
    """

    def __init__(self) -> None:
        self._fields: dict[str, _Field] = {}
        self._reading: Callable[[], AbstractContextManager[None]] = nullcontext

    def defer(self, name: str, load: Callable[[], np.ndarray], what: Deferred) -> None:
        """Keep how an array is read, in place of the array."""
        self._fields[name] = _Field(np.dtype(what.dtype), load=load, mapped=what.mapped)

    def guard(self, reading: Callable[[], AbstractContextManager[None]]) -> None:
        """Read within a context that explains errors."""
        self._reading = reading

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the fields that are not read yet."""
        return tuple(name for name, field in self._fields.items() if field.array is None)

    def bytes_waiting(self, cells: int) -> int:
        """Return the memory that reading all that is waiting takes."""
        fields = [self._fields[name] for name in self.waiting]
        return sum(cells * field.dtype.itemsize for field in fields if not field.mapped)

    def dtype(self, name: str) -> np.dtype[Any]:
        """Return the type of a field without reading it."""
        return self._fields[name].dtype

    def __copy__(self) -> Fields:
        """Return independent fields: what is read of one is not known to the other."""
        other = Fields()
        other._fields = {name: replace(field) for name, field in self._fields.items()}
        other._reading = self._reading
        return other

    def __getitem__(self, name: str) -> np.ndarray:
        field = self._fields[name]
        if field.array is None:
            assert field.load is not None
            with self._reading():
                field.array = field.load()
            field.dtype, field.load = field.array.dtype, None
            if field.owned:
                field.own()
        return field.array

    def __setitem__(self, name: str, array: np.ndarray) -> None:
        self._fields[name] = _Field(array.dtype, array)

    def __delitem__(self, name: str) -> None:
        del self._fields[name]

    def own(self, *names: str) -> None:
        """Declare that no other code holds some arrays, or will hold them once they are read."""
        for name in names:
            self._fields[name].own()

    def sealed(self, name: str) -> int | None:
        """Return a number that no other array has, if a field cannot change; None if it can."""
        return self._fields[name].sealed

    def __contains__(self, name: object) -> bool:
        return name in self._fields  # reads nothing

    def __iter__(self) -> Iterator[str]:
        return iter(self._fields)

    def __len__(self) -> int:
        return len(self._fields)
