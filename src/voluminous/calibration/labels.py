"""Labels of segmentations: the medium that draws them, and how they are recognised."""

from __future__ import annotations

import colorsys
from collections import Counter
from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..grids import CartesianGrid
from ..media import Table
from ..media.arguments import given_colors, listed
from ..volume import Volume
from .open_numbers import check_volume
from .samples import cell_runs

# More different whole numbers than atlases have parts of one organ are measured values.
_MOST = 256
# Labels are below this where no table says so: a table of FreeSurfer's has fourteen thousand.
_LARGEST = 1 << 16
# Whole numbers up to this are exact in floating point.
_EXACT = 1 << 53
# Cells of a slab, whose numbers are counted at once.
_AT_ONCE = 1 << 22
# So large a part of the cells beside the background has the same number as the next cell.
_SAME = 0.5
# Optical depth of a path length of opacity 1: a cell of a volume hides what is behind it.
_OPAQUE = 100.0
# The ratio keeps hues of neighbouring numbers apart.
_GOLDEN = 0.5 * (5**0.5 - 1)
# Bytes of a file up to which fields are read as wholes.
_WHOLE = 256 << 20
# Part of the longest side of a volume to which opacities refer.
_PART = 1 / 20
# Fixed in space: light from the camera would need a field of all cells for each direction.
_LIGHTS = [((1, -2, 2), 0.6), ((-2, -1, 1), 0.4)]


class Labels(Table):
    """Labels of a segmentation, each in its colour: a table of whole numbers.

    Label numbers are never interpolated: the default scheme is ``"second-order"``, in which colours
    and opacities of cells are interpolated between them, so that surfaces are smooth;
    ``"first-order"`` draws the cells themselves. Cells with other numbers are empty.

    Parameters
    ----------
    expr : str
        Field with labels.
    numbers : sequence of int
        The labels.
    labels : sequence of str, optional
        Their names; by default the numbers.
    colors : sequence of colours, optional
        One for each; by default hues that differ.
    opacities : float or sequence of float
        What a path length of each label takes away of the light from behind, 0 to 1. Of 1, a cell
        hides what is behind it.
    visible : bool or sequence of bool
        Whether each is drawn.
    path_length : float, Quantity or "auto"
        As in `Table`.
    shading : float
        As in `Table`, with lights that are fixed in space.

    Raises
    ------
    InputError
        If a number is not whole or given twice, lists differ in length, or an opacity is not from
        0 to 1.
    """

    discrete = True
    kind = "labels"

    def __init__(
        self,
        expr: Any,
        numbers: Sequence[int],
        labels: Sequence[str] | None = None,
        colors: Any = None,
        opacities: Any = 1.0,
        visible: Any = True,
        path_length: Any = "auto",
        *,
        shading: float = 0.7,
    ) -> None:
        count = len(numbers) if listed(numbers) else 0
        given = _each(numbers, count, "numbers", Real)
        if not count or any(number % 1 or abs(number) > _EXACT for number in given):
            raise InputError(f"numbers must be a list of whole numbers, got {numbers!r}")
        if len(set(given)) < count:
            raise InputError(f"each label has a number that no other has, got {numbers!r}")
        self.numbers = [int(number) for number in given]
        names = [str(number) for number in self.numbers] if labels is None else labels
        self.labels = _each(names, count, "labels", str)
        self._colors = label_colors(self.numbers) if colors is None else colors
        self._shares = _each(opacities, count, "opacities", Real)
        self._shown = _each(visible, count, "visible", (bool, np.bool_))
        if not all(0 <= share <= 1 for share in self._shares):
            raise InputError(f"opacities of labels must be from 0 to 1, got {opacities!r}")
        hues = np.broadcast_to(given_colors(self._colors, count), (count, 3))
        self._colors = self._colors if listed(self._colors) else hues.tolist()
        with np.errstate(divide="ignore"):
            depth = np.minimum(-np.log1p(-np.asarray(self._shares, float)), _OPAQUE)
            depth *= self._shown
        # Linear in between; numbers that no label has are empty.
        places = np.asarray(self.numbers, float)
        values = np.unique(np.concatenate([places - 1, places, places + 1]))
        columns = np.zeros((len(values), 4))
        columns[np.searchsorted(values, places)] = np.column_stack([hues, np.ones(count)])
        columns[np.searchsorted(values, places)] *= depth[:, None]
        lights = _LIGHTS if isinstance(shading, Real) and shading else None
        super().__init__(
            expr, values, columns[:, :3], columns[:, 3], path_length, shading=shading, lights=lights
        )

    def describe(self) -> dict[str, Any]:
        of_table = super().describe()
        return {
            **{key: of_table[key] for key in ("type", "expr")},
            "numbers": self.numbers,
            "labels": self.labels,
            "colors": [c if isinstance(c, str) else np.asarray(c).tolist() for c in self._colors],
            "opacities": self._shares,
            "visible": self._shown,
            "path_length": of_table["path_length"],
            "shading": self.arguments()["shading"],
        }


def _each(values: Any, count: int, what: str, kind: Any) -> list[Any]:
    """Return one value for each label."""
    row = values.tolist() if type(values) is np.ndarray else values
    row = [row] * count if isinstance(row, kind) else row
    if not isinstance(row, (list, tuple)) or not all(isinstance(value, kind) for value in row):
        raise InputError(f"{what} must be a list, a value for each label, got {values!r}")
    if len(row) != count:
        raise InputError(f"{what} must be {count}, one for each number, got {len(row)}")
    return list(row)


def label_colors(numbers: Sequence[int]) -> list[list[float]]:
    """Return a colour for each number: the same for the same number in any volume."""
    hues = [(number * _GOLDEN % 1.0, 0.45 + 0.15 * (number % 3)) for number in numbers]
    return [[round(c, 3) for c in colorsys.hsv_to_rgb(hue, s, 1.0)] for hue, s in hues]


def labels(volume: Volume, field: Any = None, **overrides: Any) -> Labels:
    """Return a medium that shows a segmentation, its labels in the colours of their table.

    Names, colours, opacities and which are visible are those of ``volume.meta["labels"][field]``, a
    list of ``{"number": 1, "name": "liver", "color": [0.8, 0.4, 0.3]}``, as far as they are there.
    The background is the label 0 or, without a table, that of most of the outermost cells.
    """
    check_volume("labels", "first", volume)
    tables = volume.meta.get("labels") or {}
    expr = Expression(field if field is not None else next(iter({**tables, **volume.units}), ""))
    numbered: tuple[Sequence[float], int] | None = None
    if tables.get(expr.text):
        found = np.unique(volume.evaluate(expr))
        found = found[~np.isnan(found)]
        numbered = (found.tolist(), 0) if np.all(found % 1 == 0) else None
    else:
        numbered = counted(volume, expr)
    if numbered is None:
        raise InputError(
            f"{expr.text} holds no labels: these are up to {_MOST} whole numbers, each of many "
            "cells, or have a table; choose another field"
        )
    numbers = [int(number) for number in numbered[0] if number != numbered[1]]
    if not numbers:
        raise InputError(f"{expr.text} has no label: it is {numbered[1]} everywhere")
    return labelled(volume, expr, numbers, **overrides)


def labelled(volume: Volume, expr: Expression, numbers: list[int], **overrides: Any) -> Labels:
    """Return the medium of labels that are in a volume."""
    table = (volume.meta.get("labels") or {}).get(expr.text, ())
    entries: dict[int, dict[str, Any]]
    entries = {n: {"color": c} for n, c in zip(numbers, label_colors(numbers), strict=True)}
    for entry in table:
        entries.get(int(entry["number"]), {}).update(entry)
    made: dict[str, Any] = {
        "labels": [str(entry.get("name") or number) for number, entry in entries.items()],
        "colors": [entry["color"] for entry in entries.values()],
        "opacities": [float(entry.get("opacity", 1.0)) for entry in entries.values()],
        "visible": [bool(entry.get("visible", True)) for entry in entries.values()],
        "path_length": float(f"{_PART * np.ptp(volume.grid.bounds, axis=1).max():.4g}"),
    }
    # Gradients are of whole fields, which drawing chunk by chunk does not read.
    made |= {"shading": 0.0} if volume.bytes_waiting > _WHOLE else {}
    return Labels(expr, numbers, **{**made, **overrides})


def labels_of(volume: Volume, expr: Expression, values: np.ndarray) -> list[int] | None:
    """Return the labels in a volume without the background; None if it holds no labels.

    Labels are 2 to 256 distinct whole numbers, of which two follow each other, and most cells, but
    for those of the background, are beside one with the same number: so they differ from measured
    numbers. The background is the most frequent label of the outermost cells. If the sorted samples
    `values` may be labels, all cells are read, because some labels are rare.
    """
    found = counted(volume, expr) if _whole(values) else None
    if found is None or len(found[0]) < 2:
        return None
    return [number for number in found[0] if number != found[1]]


def _whole(values: np.ndarray) -> bool:
    return bool(np.all((values == np.round(values)) & (np.abs(values) < _LARGEST)))


def counted(volume: Volume, expr: Expression) -> tuple[list[int], int] | None:
    """Return all numbers and that of the background; None if they are not labels."""
    array = np.asarray(volume.evaluate(expr))
    cells, same, around = Counter[int](), Counter[int](), Counter[int]()

    def add(counter: Counter[int], part: np.ndarray) -> None:
        numbers = part.ravel()[~np.isnan(part.ravel())].astype(np.int64)
        first = int(numbers.min(initial=0))
        counts = np.bincount(numbers - first)
        counter.update({int(k) + first: int(counts[k]) for k in np.flatnonzero(counts)})

    for slab in np.array_split(array, max(1, array.size // _AT_ONCE)):
        if not _whole(slab[~np.isnan(slab)]):
            return None
        add(cells, slab)
        add(same, slab[..., 1:][slab[..., 1:] == slab[..., :-1]])
        if len(cells) > _MOST:
            return None
    if isinstance(volume.grid, CartesianGrid):
        sides = [array.take(k, axis) for axis in range(3) for k in (0, -1)]
    else:
        sides = [run.outermost() for run in cell_runs(volume, expr, np.inf)]
    for side in sides:
        add(around, side)
    background = max(around, key=lambda number: (around[number], -number), default=0)
    if min(np.diff(sorted(cells)), default=1) > 1:  # steps of a coarsely measured number
        return None
    others = [number for number in cells if number != background]
    if sum(same[n] for n in others) < _SAME * sum(cells[n] for n in others):
        return None
    return sorted(cells), background
