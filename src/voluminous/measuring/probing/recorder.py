"""A scheme that writes down every segment that another one solves."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...backend import dr
from ...grids.two_walks import cell_of
from ...schemes.contract import carried_beyond
from ...schemes.linear import looked_up

# The middle and the two halves of a segment, of which coefficients are the mean.
_HALVES = ((0.0, 0.5), (0.5, 1.0))


class Tape:
    """Rows of numbers that a kernel writes, one after another.

    Parameters
    ----------
    capacity : int
        Rows that there is room for; what comes later is lost, though counted.
    """

    def __init__(self, backend: Any, capacity: int) -> None:
        self.backend, self.capacity = backend, capacity
        self.columns: dict[str, list[Any]] = {}
        self.limit = dr.opaque(backend.UInt, capacity)

    def prepare(self, columns: dict[str, int]) -> None:
        """Make room for so many numbers of each name."""
        for name, count in columns.items():
            kind = self.backend.UInt if name == "cell" else self.backend.Wide
            self.columns[name] = [dr.zeros(kind, self.capacity) for _ in range(count)]
        dr.eval(self.columns)

    def write(self, row: Any, active: Any, values: dict[str, list[Any]]) -> None:
        """Write a row (traced)."""
        there = active & (row < self.limit)
        for name, numbers in values.items():
            for column, number in zip(self.columns[name], numbers, strict=True):
                dr.scatter(column, type(column)(number), row, there)

    def read(self, count: int) -> dict[str, np.ndarray]:
        """Return the first rows, of each name an array of shape (count, numbers)."""
        return {
            name: np.array([np.asarray(c)[:count] for c in columns]).reshape(len(columns), count).T
            for name, columns in self.columns.items()
        }


class Recorder:
    """A scheme that does what another one does, and writes it to a tape.

    It carries the number of segments so far, the coefficients where the last one ended (of schemes
    with coefficients at vertices), and what the other scheme carries.
    """

    def __init__(self, scheme: Any, tape: Tape, names: tuple[str, ...]) -> None:
        self.scheme, self.tape, self.names = scheme, tape, names
        self.own = 1

    def __getattr__(self, name: str) -> Any:
        return getattr(self.scheme, name)

    def start(self, source: Any, walk: Any, track: Any, cursor: Any) -> list[Any]:
        """Carry a count of zero."""
        numbers = source.numbers
        columns = {"begin": 1, "end": 1, "cell": 1, "j": numbers.emissions}
        columns |= dict.fromkeys(("alpha", "transparency", "tau"), numbers.extinctions)
        columns["emission"] = numbers.emissions
        self.tape.prepare(columns | {f"field {name}": 1 for name in self.names})
        carried = [source.backend.UInt(0)]
        if self.scheme.place == "vertex":
            carried += source.interpolate(walk.entry_corners(track, cursor), cursor.inside)
        self.own = len(carried)
        return [*carried, *self.scheme.start(source, walk, track, cursor)]

    def leapt(
        self, source: Any, walk: Any, track: Any, cursor: Any, carried: list[Any], moved: Any
    ) -> list[Any]:
        """Let the scheme know."""
        (row, *before), inner = carried[: self.own], carried[self.own :]
        if before:
            before = looked_up(source, walk, track, cursor, before, moved)
        inner = self.scheme.leapt(source, walk, track, cursor, inner, moved)
        return [row, *before, *inner]

    def passed(self, carried: list[Any], onward: list[Any]) -> list[Any]:
        """Go on, and let the scheme know: what is not seen is written down, too."""
        inner = carried_beyond(self.scheme, carried[self.own :], onward[self.own :])
        return [*onward[: self.own], *inner]

    def solve(
        self, source: Any, walk: Any, track: Any, segment: Any, carried: list[Any], backward: bool
    ) -> tuple[Any, list[Any]]:
        """Return the segment's solution, and what to carry on."""
        row, *before = carried[: self.own]
        inner = carried[self.own :]
        found, inner = self.scheme.solve(source, walk, track, segment, inner, backward)
        (j, alpha), fields, after = self._seen(source, walk, track, segment, before)
        begin, end = (_distance(source, walk, track, t) for t in (segment.begin, segment.end))
        cell = cell_of(segment)  # wide steps are through many
        values = {"begin": [begin], "end": [end], "cell": [row if cell is None else cell]}
        values |= {"j": j, "alpha": alpha, "tau": found.depth}
        values |= {"emission": found.emission, "transparency": found.transparency}
        values |= {f"field {name}": [fields[name]] for name in self.names}
        told = segment.active & (segment.length > 0.0)  # walls in one place
        self.tape.write(row, told, values)
        return found, [row + dr.select(told, source.backend.UInt(1), 0), *after, *inner]

    def _seen(
        self, source: Any, walk: Any, track: Any, segment: Any, before: list[Any]
    ) -> tuple[Any, dict[str, Any], list[Any]]:
        """Return mean coefficients, fields in the middle, and coefficients at the end."""
        if self.scheme.place == "cell":
            return source.at(segment.cell, segment.active), {}, []
        if self.scheme.place == "vertex":
            corners = walk.exit_corners(track, segment)
            after = list(source.interpolate(corners, segment.active))
            mean = [0.5 * (a + b) for a, b in zip(before, after, strict=True)]
            return source.numbers.split(mean), {}, after
        chord = walk.chord(track, segment)
        cubics = source.cubics(chord, source.corners(chord, segment.active))
        stretch = (source.stretch if self.scheme.controlled else source.straight)(
            cubics, segment.length
        )
        halves = [source.means(stretch.panel(*half)) for half in _HALVES]
        means = [
            [0.5 * (a + b) for a, b in zip(*parts, strict=True)]
            for parts in zip(*halves, strict=True)
        ]
        return means, stretch.fields(0.5), []


def _distance(source: Any, walk: Any, track: Any, t: Any) -> Any:
    """Return how far a point of a ray is from its origin, in the volume's unit."""
    Wide = source.backend.Wide
    return (Wide(track.entry) + Wide(t)) * Wide(walk.scale)
