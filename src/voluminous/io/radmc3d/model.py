"""A directory with a model: which files are in it, and which fields in them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ...errors import FileFormatError
from ..guard import placed
from ..names import chosen_fields
from .field_file import Part, parts_of
from .grid_file import GridFile, read_grid
from .known import FORMATS, GRID, INPUT, find

_PREFERENCE = {suffix: rank for rank, suffix in enumerate(FORMATS)}


@dataclass(frozen=True)
class Model:
    """What is in a directory.

    Attributes
    ----------
    grid_path : Path
    grid : GridFile
    parts : dict of Part
        All fields by their places.
    own : tuple of str
        The places that are meant by the path which was given: all, or those in one file.
    """

    grid_path: Path
    grid: GridFile
    parts: dict[str, Part]
    own: tuple[str, ...]

    def chosen(self, fields: Any) -> dict[str, Part]:
        """Return the fields that a user asks for, by the names they shall have."""
        known = {place: part.name for place, part in self.parts.items()}
        if fields is None:
            known = {place: known[place] for place in self.own}
        else:
            fields = self._expanded(fields, known)
        return {name: self.parts[place] for name, place in chosen_fields(known, fields).items()}

    def _expanded(self, fields: Any, known: dict[str, str]) -> Any:
        """Return names in which one that stands for several species is replaced by theirs."""
        if isinstance(fields, str):
            fields = [fields]
        if not isinstance(fields, (list, tuple)):
            return fields
        found: list[Any] = []
        for name in fields:
            several = [place for place in known if place.partition(".")[0] == name]
            direct = name in known or name in known.values()
            found += several if several and not direct else [name]
        return found


def open_model(path: Path) -> Model:
    """Return what there is in a directory, or around a file in one.

    Raises
    ------
    FileFormatError
        If the grid is damaged, or the file holds nothing on it.
    """
    directory = path if path.is_dir() else path.parent
    grids = find(directory, GRID, INPUT)
    grid_path = path if path in grids else grids[0]
    if path not in grids:
        _tell_apart(grids)
    with placed(grid_path.name):
        grid = read_grid(grid_path)
    one_file = path.is_file() and path not in grids
    parts = [part for file in _files(directory, path) for part in parts_of(file, grid)]
    own = [part.place for part in parts if not one_file or part.place.split(":")[0] == path.name]
    if not own:
        known = "no file with values on the grid" if not one_file else "no values on the grid"
        raise FileFormatError(f"expected a file such as gas_density.inp; there is {known}")
    return Model(grid_path, grid, {part.place: part for part in parts}, tuple(own))


def _files(directory: Path, given: Path) -> list[Path]:
    found: dict[str, list[Path]] = {}
    for path in sorted(directory.iterdir()):
        if path.suffix in FORMATS and path.stem != GRID and path.is_file():
            found.setdefault(path.stem, []).append(path)
    chosen = []
    for paths in found.values():
        paths.sort(key=lambda path: (path != given, _PREFERENCE[path.suffix]))
        if paths[0] != given:
            _tell_apart(paths)
        chosen.append(paths[0])
    return chosen


def _tell_apart(paths: list[Path]) -> None:
    if len(paths) > 1:
        others = " and ".join(path.name for path in paths[1:])
        warnings.warn(
            f"{paths[0].name} is read, and {others} beside it is not; RADMC-3D would stop at that",
            stacklevel=2,
        )


def holds_model(path: Path, head: bytes) -> bool:
    """Return True for a directory with a grid, and for a file beside one that begins as they do."""
    directory = path if path.is_dir() else path.parent
    if path.is_file() and (path.suffix not in FORMATS or not _begins(path.suffix, head)):
        return False
    return bool(find(directory, GRID, INPUT))


def _begins(suffix: str, head: bytes) -> bool:
    numbers, size = ((4, 8, 16), 4) if suffix[1] == "u" else ((1, 2), 8)
    if suffix[1] in "ub":
        orders: tuple[Literal["little", "big"], ...] = ("little", "big")
        return any(head[:size] == n.to_bytes(size, order) for n in numbers for order in orders)
    return head.split(maxsplit=1)[:1] in ([b"1"], [b"2"])
