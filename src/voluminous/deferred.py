"""Fields that are read when they are first used."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, MutableMapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .errors import FileFormatError

# Each sealed array gets another number.
_NUMBERS = itertools.count()


def seal(array: np.ndarray) -> bool:
    """Make an array and its bases read-only; False if it does not own its memory.

    The memory of a file that a user has mapped, for example, changes with the file.
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
class Pieces:
    """How a part of a field is read: fields larger than memory are used box by box.

    Attributes
    ----------
    read : callable
        ``read(low, high, level)`` returns the cells ``low <= i < high`` of a level, axes as the
        grid has them; level 0 is the field itself.
    chunks : tuple of three int, optional
        Cells of the pieces that are stored; None if any box is as good as another.
    coarser : tuple of shapes
        Shapes of the levels that are stored beside the field, each of half as many cells as the one
        before along some axes, the last cell of an axis being of one or two.
    extremes : callable, optional
        Returns the least and the largest value of each piece, shape ``(kx, ky, kz, 2)``.
    """

    read: Callable[[Sequence[int], Sequence[int], int], np.ndarray]
    chunks: tuple[int, ...] | None = None
    coarser: tuple[tuple[int, ...], ...] = ()
    extremes: Callable[[], np.ndarray] | None = None


@dataclass(frozen=True)
class Deferred:
    """A field that is not read yet: ``volume["density"] = Deferred(read, "f4")``.

    Attributes
    ----------
    load : callable
        Returns the values as plain numbers.
    dtype : dtype
    unit : str or unit, optional
    pieces : Pieces, optional
        How a box of it is read without the rest.
    """

    load: Callable[[], Any]
    dtype: Any
    unit: Any = None
    pieces: Pieces | None = None


@dataclass
class _Field:
    """One array, or how it is read.

    `sealed` is its number if it cannot change, read or not; `origin` the file it is from, how
    that is read, and its stamp when it was opened (empty for a directory).
    """

    dtype: np.dtype[Any]
    array: np.ndarray | None = None
    load: Callable[[], np.ndarray] | None = None
    pieces: Pieces | None = None
    shape: tuple[int, ...] = ()
    ranges: np.ndarray | None = None  # that its pieces tell, once they were read
    owned: bool = False
    sealed: int | None = None
    origin: tuple[Path, str, str] | None = None
    again: Callable[[], np.ndarray] | None = None  # in other processes, in place of `load`

    def __getstate__(self) -> dict[str, Any]:
        read = self.array is not None and self.pieces is None
        state = {**vars(self), "sealed": None}  # numbers are those of one process
        state["load"] = None if read else self.again or self.load
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if self.owned:
            self.own()

    def own(self) -> None:
        self.owned = True
        fixed = self.array is None or seal(self.array)
        if not fixed:
            self.sealed = None
        elif self.sealed is None:
            self.sealed = next(_NUMBERS)


class Fields(MutableMapping[str, np.ndarray]):
    """Arrays by name; deferred ones are read at first use.

    Arrays that no other code holds are *sealed*: read-only, so that their contents need not be
    hashed to know whether they have changed.
    """

    def __init__(self) -> None:
        self._fields: dict[str, _Field] = {}
        self.reading: Callable[[], AbstractContextManager[None]] = nullcontext

    def defer(
        self, name: str, load: Callable[[], np.ndarray], what: Deferred, shape: tuple[int, ...]
    ) -> None:
        """Keep how an array is read, in place of the array."""
        self._fields[name] = _Field(
            np.dtype(what.dtype), load=load, pieces=what.pieces, shape=shape
        )

    def guard(
        self,
        reading: Callable[[], AbstractContextManager[None]],
        origin: tuple[Path, str, str] | None = None,
        again: Callable[[str], np.ndarray] | None = None,
    ) -> None:
        """Read within a context that explains errors; remember the file and how it is read."""
        self.reading = reading
        for name, field in self._fields.items():
            self.set_origin(name, origin)
            field.again = None if again is None else functools.partial(again, name)

    def origin(self, name: str) -> tuple[Path, str, str] | None:
        """Return the file that a field is from, and how it is read; None if it was set."""
        return self._fields[name].origin

    def set_origin(self, name: str, origin: tuple[Path, str, str] | None) -> None:
        """Set the file that a field is from, and how it is read."""
        self._fields[name].origin = origin

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the fields that are not read yet."""
        return tuple(name for name, field in self._fields.items() if field.array is None)

    def bytes_waiting(self, cells: int) -> int:
        """Return the memory that reading all that is waiting takes."""
        fields = [self._fields[name] for name in self.waiting]
        return sum(cells * field.dtype.itemsize for field in fields)

    def dtype(self, name: str) -> np.dtype[Any]:
        """Return the type of a field without reading it."""
        return self._fields[name].dtype

    def pieces(self, name: str) -> Pieces | None:
        """Return how boxes of a field are read from its file; None if it has none."""
        return self._fields[name].pieces

    def box(
        self, name: str, low: Sequence[int], high: Sequence[int], level: int = 0
    ) -> np.ndarray | None:
        """Return the cells ``low <= i < high`` as their file has them; None if they must be sliced.

        A field that was read is sliced.
        """
        field = self._fields[name]
        if field.pieces is None or (level == 0 and field.array is not None):
            return None
        with self._naming_chunk(name, low, high, level):
            return field.pieces.read(low, high, level)

    def piece_extremes(self, name: str) -> np.ndarray | None:
        """Return the least and largest values that a file tells of its pieces, or None."""
        field = self._fields[name]
        if field.ranges is None and field.pieces is not None and field.pieces.extremes is not None:
            with self.reading():
                field.ranges = field.pieces.extremes()
        return field.ranges

    @contextmanager
    def _naming_chunk(
        self, name: str, low: Sequence[int], high: Sequence[int], level: int
    ) -> Iterator[None]:
        try:
            with self.reading():
                yield
        except FileFormatError as error:
            where = f"field {name!r}, level {level}"
            if (number := self._damaged(name, low, high, level)) is not None:
                where += f", chunk {number}"
            raise type(error)(f"{error} ({where})") from error.__cause__

    def _damaged(
        self, name: str, low: Sequence[int], high: Sequence[int], level: int
    ) -> tuple[int, ...] | None:
        pieces = self._fields[name].pieces
        if pieces is None or pieces.chunks is None:
            return None
        sides = pieces.chunks
        spans = [range(a // c, -(-b // c)) for a, b, c in zip(low, high, sides, strict=True)]
        for number in itertools.product(*spans):
            ends = list(zip(number, sides, low, high, strict=True))
            try:
                with self.reading():
                    first = [max(i * c, a) for i, c, a, _ in ends]
                    pieces.read(first, [min(i * c + c, b) for i, c, _, b in ends], level)
            except FileFormatError:
                return number
        return None

    def __copy__(self) -> Fields:
        """Return independent fields: what is read of one is not known to the other."""
        other = Fields()
        other._fields = {name: replace(field) for name, field in self._fields.items()}
        other.reading = self.reading
        return other

    def __getitem__(self, name: str) -> np.ndarray:
        field = self._fields[name]
        if field.array is None:
            assert field.load is not None
            with self._naming_chunk(name, (0,) * len(field.shape), field.shape, 0):
                field.array = field.load()
            field.dtype = field.array.dtype
            if field.owned:
                field.own()
        return field.array

    def __setitem__(self, name: str, array: np.ndarray) -> None:
        self._fields[name] = _Field(array.dtype, array)

    def __delitem__(self, name: str) -> None:
        del self._fields[name]

    def unread(self) -> None:
        """Forget the arrays that can be read again in pieces, and that cannot have been changed."""
        for field in self._fields.values():
            fixed = field.owned and field.array is not None and not field.array.flags.writeable
            if field.pieces is not None and field.load is not None and fixed:
                field.array = field.sealed = None

    def own(self, *names: str) -> None:
        """Declare that no other code holds some arrays, or will hold them once they are read."""
        for name in names:
            self._fields[name].own()

    def sealed(self, name: str) -> int | None:
        """Return a number that no other array has, if a field cannot change; None if it can."""
        return self._fields[name].sealed

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in self._fields  # reads nothing

    def __iter__(self) -> Iterator[str]:
        return iter(self._fields)

    def __len__(self) -> int:
        return len(self._fields)
