"""Volumes as models of RADMC-3D."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import FileFormatError, InputError
from ...files import MissingPathError, replacing
from .encoders import BinaryOut, TextOut
from .fields_out import FileOut, files_out
from .grid_file import GridFile, read_grid
from .grid_out import GridOut, grid_out
from .known import FORMATS, GRID, INPUT, find

if TYPE_CHECKING:
    from ...volume import Volume


def write(
    volume: Volume,
    directory: str | Path,
    fields: Any = None,
    *,
    binary: bool = False,
    overwrite: bool = False,
) -> list[Path]:
    """Write a volume into a directory as a model of RADMC-3D: the grid, and a file per quantity.

    `voluminous.open` gives back the same bits. RADMC-3D itself needs more than these: at least
    ``wavelength_micron.inp``, and opacities or lines.

    Parameters
    ----------
    volume : Volume
        On a Cartesian grid, an octree, patches or a spherical grid. Patches are written as layers
        if they are nested as RADMC-3D's are, or else as an octree.
    directory : str or Path
        It is made if its parent exists.
    fields : dict, optional
        From names of files, such as ``"gas_density"``, to what shall be in them: a field, an
        expression, a number; a vector's name, or three of those; a list for several dust species.
        By default all fields that are called like one of RADMC-3D's files, and ``density``,
        ``temperature`` and ``velocity`` as the gas's; a warning names those that are left out.
        Units are converted to RADMC-3D's (g, cm, s, K); what has none is taken to be in them.
    binary : bool, optional
        Write ``.binp`` and ``.bdat`` instead of text with 17 digits. Of RADMC-3D 2.0, which cannot
        read ``gas_density.binp``, not that file.
    overwrite : bool, optional
        Replace files of these names, in whatever form they are there. A grid file that says the
        same already is always left as it is.

    Returns
    -------
    list of Path
        The files that were written.

    Raises
    ------
    InputError
        If files are there already, RADMC-3D has no such grid, or there is nothing to write.
    UnitsError
        If a field is no such quantity.

    Examples
    --------
    >>> sphere = vm.models.sphere(8)
    >>> paths = vm.io.radmc3d.write(sphere, "model", {"dust_density": "1e-18 * inside"})
    >>> [path.name for path in paths]
    ['amr_grid.inp', 'dust_density.inp']
    """
    directory = Path(directory)
    files = files_out(volume, fields)
    grid = grid_out(volume.grid, volume.meta.get("coordsystem"))
    if not directory.is_dir() and not directory.parent.is_dir():
        raise MissingPathError(f"the directory {directory.parent} does not exist; create it first")
    work: dict[Path, Callable[[TextOut | BinaryOut], None]] = {}
    if not _is_there(directory, grid.file):
        work[directory / (GRID + _ending(".inp", binary))] = functools.partial(_write_grid, grid)
    for file in files:
        path = directory / (file.stem + _ending(file.kind.ending, binary))
        work[path] = functools.partial(_write_field, volume, grid, file)
    _check_place(work, overwrite)
    directory.mkdir(exist_ok=True)
    _replace(work, binary)
    return list(work)


def _ending(text: str, binary: bool) -> str:
    return f".b{text[1:]}" if binary else text


def _forms(path: Path) -> list[Path]:
    return find(path.parent, path.stem, tuple(FORMATS))


def _is_there(directory: Path, grid: GridFile) -> bool:
    there = find(directory, GRID, INPUT)
    if len(there) != 1:
        return False
    try:
        return read_grid(there[0]) == grid
    except FileFormatError:
        return False


def _check_place(paths: Iterable[Path], overwrite: bool) -> None:
    there = [old for path in paths for old in _forms(path)]
    if there and not overwrite:
        listed = ", ".join(path.name for path in there)
        raise InputError(
            f"{there[0].parent} has {listed} already; give overwrite=True to replace that"
        )


def _replace(work: dict[Path, Callable[[TextOut | BinaryOut], None]], binary: bool) -> None:
    """Write all files, then put them in their places: fields are of no use on another grid.

    Their other forms are removed: RADMC-3D stops where there are two.
    """
    with ExitStack() as stack:
        for path, put in work.items():
            with stack.enter_context(replacing(path)).open("wb") as file:
                put(BinaryOut(file) if binary else TextOut(file))
    for path in work:
        for other in _forms(path):
            if other != path:
                other.unlink()


def _write_grid(grid: GridOut, out: TextOut | BinaryOut) -> None:
    found = grid.file
    out.format(1)
    out.integers(found.style)
    out.integers(found.coordinates)
    out.integers(0)
    out.integers(*map(int, found.active))
    out.integers(*found.shape)
    if found.flags is not None:
        out.integers(grid.levels, found.cells, len(found.flags))
    if found.layers is not None:
        out.integers(grid.levels, len(found.layers))
    for walls in found.walls:
        out.rows([walls])
    if found.flags is not None:
        out.flags(found.flags)
    for row in () if found.layers is None else found.layers.tolist():
        out.integers(*row)


def _write_field(volume: Volume, grid: GridOut, file: FileOut, out: TextOut | BinaryOut) -> None:
    out.format(1, single=all(column.is_single(volume) for column in file.columns))
    out.integers(grid.file.cells)
    if file.kind.layout == "species":
        out.integers(len(file.columns))
        for column in file.columns:
            out.rows([grid.flat(column.values(volume))])
    else:
        out.rows([grid.flat(column.values(volume)) for column in file.columns])
