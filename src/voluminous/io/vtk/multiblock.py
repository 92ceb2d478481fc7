"""Files of VTK that name others: blocks (.vtm), levels of patches (.vthb), a series (.pvd)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import FileFormatError, InputError
from ..guard import placed
from ..payload import inside
from .axes import ADVICE
from .dataset import Dataset
from .files import dataset
from .library import children, needed, tree

# All of these have elements <DataSet> that name files, at any depth.
_KINDS = (
    *("vtkMultiBlockDataSet", "vtkPartitionedDataSet", "vtkPartitionedDataSetCollection"),
    *("vtkOverlappingAMR", "vtkNonOverlappingAMR", "vtkHierarchicalBoxDataSet"),
)
_SERIES = "Collection"
_MOST_BLOCKS, _LISTED = 100_000, 8


@dataclass(frozen=True)
class Block:
    """A file that another names, and what it is called there."""

    name: str
    path: Path

    def __str__(self) -> str:
        """Return what a user can open."""
        return f"{self.name} ({self.path})" if self.name else str(self.path)


def names_others(root: Any) -> bool:
    """Return True for a file that only names others."""
    return root.GetAttribute("type") in (*_KINDS, _SERIES)


def datasets(path: Path) -> dict[Block, Dataset]:
    """Return the blocks on regular grids; a warning names those that are none.

    Raises
    ------
    InputError
        If there is none, or it is a series of several times; says what to open.
    FileFormatError
        If one is damaged, or lies elsewhere.
    """
    found, others, why = {}, [], ""
    for block in _blocks(path):
        try:
            with placed(block.path.name):
                found[block] = dataset(block.path)
        except FileFormatError:
            raise
        except InputError as error:
            others.append(block)
            why = why or str(error)
    if not found and len(others) == 1:
        raise InputError(why)
    if not found:
        raise InputError(f"none of its blocks is a regular grid{ADVICE}:\n{listed(others)}")
    if others:
        warnings.warn(
            f"{path.name}: blocks that are no regular grids are left out:\n{listed(others)}",
            stacklevel=2,
        )
    return found


def listed(blocks: list[Block]) -> str:
    """Return lines that name blocks."""
    more = len(blocks) - _LISTED
    lines = [f"  {block}" for block in blocks[:_LISTED]]
    return "\n".join(lines + ([f"  … and {more} more"] if more > 0 else []))


def _blocks(path: Path) -> list[Block]:
    root = tree(path)
    told = root.GetAttribute("type")
    told_of = list(_named(needed(root, told), ""))
    if not told_of:
        raise FileFormatError("it names no files of data")
    if len(told_of) > _MOST_BLOCKS:
        raise FileFormatError(f"it names {len(told_of)} files, more than {_MOST_BLOCKS}")
    if told == _SERIES:
        _check_times(path, [element for _, element in told_of])
    return [
        Block(name, path.parent / element.GetAttribute("file"))
        for name, element in told_of
        if inside(path.parent, element.GetAttribute("file"))
    ]


def _named(element: Any, above: str) -> Iterator[tuple[str, Any]]:
    """Give the elements of files, each with its name: those of the blocks it is in before it."""
    for child in children(element):
        own = child.GetAttribute("name") or ""
        name = f"{above}/{own}" if above and own else above or own
        if child.GetName() == "DataSet" and child.GetAttribute("file"):
            yield name, child
        else:
            yield from _named(child, name)


def _check_times(path: Path, sets: list[Any]) -> None:
    times = {element.GetAttribute("timestep") or "0": element for element in sets}
    if len(times) > 1:
        lines = [f"  {path.parent / e.GetAttribute('file')} (time {t})" for t, e in times.items()]
        more = [f"  … and {len(lines) - _LISTED} more"] if len(lines) > _LISTED else []
        raise InputError(
            f"it is a series of {len(times)} times; open one of them:\n"
            + "\n".join(lines[:_LISTED] + more)
        )
