"""From what a file of VTK tells to a volume: which arrays, at points or in cells."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError
from ..contract import FieldInfo, Reader
from ..names import chosen_fields
from ..scanners.placement import Arrangement
from .dataset import CELL, POINT, Array, Dataset, is_internal

if TYPE_CHECKING:
    from ...volume import Volume

# Bits of ``vtkGhostType`` (vtkDataSetAttributes.h) that say that there is nothing to see.
_HIDDEN = {POINT: 2, CELL: 32}
_GHOSTS = "vtkGhostType"
OPTIONS = {
    "unit": "unit of length",
    "resolution": "resample to equal cells: how many along the longest side, or three numbers",
}


class DatasetReader(Reader):
    """A reader that makes a `Dataset` of a file; what there is in it follows."""

    options = OPTIONS

    def dataset(self, path: Path, **options: Any) -> Dataset:
        """Return what a file tells, with the reader's options but for ``unit``."""
        raise NotImplementedError

    def read(self, path: Path, fields: Any = None, *, unit: Any = None, **options: Any) -> Volume:
        return volume_of(self.dataset(path, **options), fields, unit)

    def info(self, path: Path, *, unit: Any = None, **options: Any) -> tuple[FieldInfo, ...]:
        return infos(self.dataset(path, **options))


class Parts:
    """The components of an array, decoded once: those nobody has asked for yet are kept.

    Parameters
    ----------
    array : Array
        The array.
    wanted : set of int
        Components that will be asked for.
    """

    def __init__(self, array: Array, wanted: set[int]) -> None:
        self._array, self._wanted = array, wanted
        self._kept: dict[int, np.ndarray] = {}

    def take(self, component: int) -> np.ndarray:
        """Return one component, shape (nz, ny, nx)."""
        if component not in self._kept:
            values = self._array.load()
            self._kept = {k: values[..., k] for k in self._wanted | {component}}
        self._wanted = self._wanted - {component}
        return self._kept.pop(component)


def volume_of(dataset: Dataset, fields: Any = None, unit: Any = None) -> Volume:
    """Return the volume of a dataset, whose fields are read when they are used.

    Parameters
    ----------
    dataset : Dataset
        What there is.
    fields : None, str, sequence of str or dict
        As for `voluminous.open`; by default all at points, or all in cells.
    unit : str or unit, optional
        Of lengths.

    Raises
    ------
    InputError
        If fields at points and in cells are asked for.
    FileFormatError
        If there are none.
    """
    from ...volume import Volume

    chosen = chosen_arrays(dataset, fields)
    at = common_place(chosen)
    arrangement = dataset.arrange(at, unit or dataset.meta.get("length_unit"))
    volume = Volume(arrangement.grid)
    volume.meta |= {name: v for name, v in dataset.meta.items() if name != "length_unit"}
    if arrangement.direction is not None:
        volume.meta["direction"] = arrangement.direction.tolist()
        chosen = chosen_arrays(dataset, fields, upright=False)
    source = Source(dataset, chosen, arrangement)
    for name, (array, _) in chosen.items():
        volume[name] = Deferred(functools.partial(source.load, name), array.dtype, array.unit)
    return volume


class Source:
    """What reads the fields that are chosen of a dataset, each as an array on its grid."""

    def __init__(
        self, dataset: Dataset, chosen: dict[str, tuple[Array, int]], arrangement: Arrangement
    ) -> None:
        at = common_place(chosen)
        self._hidden = next((a for a in dataset.arrays if (a.name, a.at) == (_GHOSTS, at)), None)
        self._chosen, self._parts, self._arrangement = chosen, _parts(chosen), arrangement

    def load(self, name: str) -> np.ndarray:
        """Return the values of a field; NaN where VTK hides them."""
        array, component = self._chosen[name]
        values, hidden = self._parts[array.place].take(component), self._hidden
        if hidden is not None and values.dtype.kind == "f":
            blank = (hidden.load()[..., 0] & _HIDDEN[hidden.at]) != 0
            values = np.where(blank, values.dtype.type(np.nan), values)
        return self._arrangement.put(values.transpose())


def _parts(chosen: dict[str, tuple[Array, int]]) -> dict[str, Parts]:
    wanted: dict[str, set[int]] = {}
    for array, component in chosen.values():
        wanted.setdefault(array.place, set()).add(component)
    return {array.place: Parts(array, wanted[array.place]) for array, _ in chosen.values()}


def infos(dataset: Dataset) -> tuple[FieldInfo, ...]:
    """Return what there is to read."""
    return tuple(
        FieldInfo(name, place, dataset.shape(array.at), str(array.dtype), array.unit)
        for place, (name, array, _) in _known(dataset).items()
    )


def _known(dataset: Dataset, upright: bool = True) -> dict[str, tuple[str, Array, int]]:
    """Return, by place, the name, array and component of all fields; preferred ones first."""
    preferred = dataset.preferred()
    known = {}
    for array in sorted(dataset.arrays, key=lambda array: array.at != preferred):
        several = array.components > 1
        endings = array.endings(upright)
        for k, (name, ending) in enumerate(zip(array.names(upright), endings, strict=True)):
            place = f"{array.place}/{ending[1:]}" if several else array.place
            known[place] = (name, array, k)
    return known


def chosen_arrays(
    dataset: Dataset, fields: Any, upright: bool = True
) -> dict[str, tuple[Array, int]]:
    """Return array and component of each field that is asked for, by its name.

    Raises
    ------
    FileFormatError
        If there are no arrays.
    UnknownNameError
        If there is none of that name.
    """
    known = _known(dataset, upright)
    if not known:
        raise FileFormatError("expected values at points or in cells, there are none")
    offered = known
    if fields is None:
        preferred = dataset.preferred()
        shown = {p: k for p, k in known.items() if k[1].at == preferred}
        offered = {p: k for p, k in shown.items() if not is_internal(k[1])} or shown or known
    places = chosen_fields({place: name for place, (name, _, _) in offered.items()}, fields)
    return {name: known[place][1:] for name, place in places.items()}


def common_place(chosen: dict[str, tuple[Array, int]]) -> str:
    """Return where the values of all fields are.

    Raises
    ------
    InputError
        If some are at points, and some in cells.
    """
    found = {array.at for array, _ in chosen.values()}
    if len(found) > 1:
        listed = "; ".join(
            f"{at}s: " + ", ".join(n for n, (array, _) in chosen.items() if array.at == at)
            for at in sorted(found)
        )
        raise InputError(
            f"values at points and in cells are on different grids; choose fields of one kind "
            f"({listed})"
        )
    return found.pop()
