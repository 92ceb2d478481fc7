"""Writer for RADMC-3D models."""

from __future__ import annotations

import functools
import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError, UnitsError
from ...expressions import Expression
from ...files import MissingPathError, replacing
from ...units import is_quantity, parse_unit, plain
from ..contract import FieldChoice
from .encodings import BinaryOut, TextOut
from .fields import FORMATS, GRID, INPUT, KINDS, FieldKind, find, known_kind
from .grid_file import GridFile, read_grid
from .grid_out import GridOut, grid_out

if TYPE_CHECKING:
    from ...volume import Volume

# Other codes' names of gas quantities.
_USUAL = {"density": "gas_density", "temperature": "gas_temperature", "velocity": "gas_velocity"}
_STEM = re.compile(r"[A-Za-z0-9_+-]+")
_NOT_WRITTEN = ("levels", "frequencies")


def write(
    volume: Volume,
    directory: str | Path,
    fields: FieldChoice = None,
    *,
    binary: bool = False,
    overwrite: bool = False,
) -> list[Path]:
    """Write a volume into a directory as a RADMC-3D model: the grid, and one file per quantity.

    `voluminous.open` reads it back bit for bit. RADMC-3D itself needs further files: at least
    ``wavelength_micron.inp``, and opacities or lines.

    Parameters
    ----------
    volume : Volume
        On a Cartesian grid, an octree, patches or a spherical grid. Patches are written as layers
        if they are nested as RADMC-3D requires, else as an octree.
    directory : str or Path
        Created if it does not exist; its parent must exist.
    fields : dict, optional
        Contents of the files by file name, such as ``"gas_density"``: a field, an expression or a
        number; for vectors a vector's name or three components; for several dust species a list.
        Default: all fields named like a RADMC-3D file, and ``density``, ``temperature`` and
        ``velocity`` as those of the gas; a warning lists the omitted fields. Units are converted
        to RADMC-3D's (g, cm, s, K); fields without a unit are assumed to be in these.
    binary : bool, optional
        Write ``.binp`` and ``.bdat`` instead of text with 17 digits. RADMC-3D 2.0 reads these
        except for ``gas_density.binp``.
    overwrite : bool, optional
        Replace files of these names in any of their formats. A grid file with the same contents is
        never rewritten.

    Returns
    -------
    list of Path
        The written files.

    Examples
    --------
    >>> sphere = vm.models.sphere(8)
    >>> paths = vm.io.radmc3d.write(sphere, "model", {"dust_density": "1e-18 * inside"})
    >>> [path.name for path in paths]
    ['amr_grid.inp', 'dust_density.inp']
    """
    directory = Path(directory)
    files = _files_out(volume, fields)
    grid = grid_out(volume.grid, volume.meta.get("coordsystem"))
    if not directory.is_dir() and not directory.parent.is_dir():
        raise MissingPathError(f"the directory {directory.parent} does not exist; create it first")
    work: dict[Path, Callable[[TextOut], None]] = {}
    if not _is_there(directory, grid.file):
        work[directory / (GRID + _ending(".inp", binary))] = functools.partial(_write_grid, grid)
    for file in files:
        path = directory / (file.stem + _ending(file.kind.suffix, binary))
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
        with FORMATS[there[0].suffix](there[0]) as source:
            return read_grid(source) == grid
    except FileFormatError:
        return False


def _check_place(paths: Iterable[Path], overwrite: bool) -> None:
    there = [old for path in paths for old in _forms(path)]
    if there and not overwrite:
        listed = ", ".join(path.name for path in there)
        raise InputError(
            f"{there[0].parent} has {listed} already; give overwrite=True to replace that"
        )


def _replace(work: dict[Path, Callable[[TextOut], None]], binary: bool) -> None:
    """Write all files, then move them into place, so that fields and grid always match.

    Files of the same name in other formats are removed: RADMC-3D stops if there are two.
    """
    with ExitStack() as stack:
        for path, put in work.items():
            with stack.enter_context(replacing(path)).open("wb") as file:
                put(BinaryOut(file) if binary else TextOut(file))
    for path in work:
        for other in _forms(path):
            if other != path:
                other.unlink()


def _write_grid(grid: GridOut, out: TextOut) -> None:
    file = grid.file
    out.format(1)
    out.integers(file.style)
    out.integers(file.coordinates)
    out.integers(0)
    out.integers(*map(int, file.active))
    out.integers(*file.shape)
    if file.flags is not None:
        out.integers(grid.levels, file.cells, len(file.flags))
    if file.layers is not None:
        out.integers(grid.levels, len(file.layers))
    for walls in file.walls:
        out.rows([walls])
    if file.flags is not None:
        out.flags(file.flags)
    for row in () if file.layers is None else file.layers.tolist():
        out.integers(*row)


def _write_field(volume: Volume, grid: GridOut, file: FileOut, out: TextOut) -> None:
    out.format(1, single=all(column.is_single(volume) for column in file.columns))
    out.integers(grid.file.cells)
    if file.kind.layout == "species":
        out.integers(len(file.columns))
        for column in file.columns:
            out.rows([grid.flat(column.values(volume))])
    else:
        out.rows([grid.flat(column.values(volume)) for column in file.columns])


@dataclass(frozen=True)
class WrittenColumn:
    """An expression, and the factor that converts it to the file's unit."""

    expression: Expression
    factor: float

    def is_single(self, volume: Volume) -> bool:
        return self.factor == 1 and volume.evaluate_cells(self.expression, 0, 1).dtype == np.float32

    def values(self, volume: Volume) -> np.ndarray:
        found: np.ndarray = volume.evaluate(self.expression)
        return found if self.factor == 1 else found.astype(np.float64) * self.factor


@dataclass(frozen=True)
class FileOut:
    """A file to write: name without suffix, kind, and one, three or several columns."""

    stem: str
    kind: FieldKind
    columns: list[WrittenColumn]


def _files_out(volume: Volume, fields: FieldChoice) -> list[FileOut]:
    if fields is None:
        given = _guessed(volume)
    elif isinstance(fields, Mapping) and fields:
        given = dict(fields)
    else:
        raise InputError(
            "fields must be a table from the names of files to fields, such as "
            f"{{'gas_density': 'rho'}}, got {fields!r}"
        )
    return [_file(volume, stem, what) for stem, what in given.items()]


def _guessed(volume: Volume) -> dict[str, Any]:
    given: dict[str, Any] = {}
    for name in volume.fields:
        stem = _stem_of(volume, name)
        if stem is not None:
            given.setdefault(stem, []).append(name)
    for usual, stem in _USUAL.items():
        names = _components(volume, usual) if stem == "gas_velocity" else [usual]
        if stem not in given and all(name in volume.fields for name in names):
            given[stem] = names
    written = {name for names in given.values() for name in names}
    left = [name for name in volume.fields if name not in written]
    example = f"fields={{'gas_density': {left[0]!r}}}" if left else ""
    if not given:
        listed = ", ".join(KINDS)
        raise InputError(
            f"none of the fields {', '.join(left) or '(there are none)'} is called like one of "
            f"RADMC-3D's files ({listed}, numberdens_…); say what they are with {example}"
        )
    if left:
        warnings.warn(
            f"left out: {', '.join(left)}; say which file a field is for with {example}",
            stacklevel=4,
        )
    return given


def _components(volume: Volume, vector: str) -> list[str]:
    return [f"{vector}_{axis}" for axis in volume.grid.coordinates]


def _stem_of(volume: Volume, name: str) -> str | None:
    kind = known_kind(name)
    if kind is not None:
        return name if kind.layout in ("scalar", "species") else None
    stem, _, ending = name.rpartition("_")
    kind = known_kind(stem)
    if kind is None:
        return None
    if kind.layout == "vector" and ending in volume.grid.coordinates:
        whole = all(part in volume.fields for part in _components(volume, stem))
        return stem if whole else None
    return stem if kind.layout == "species" and ending.isdigit() else None


def _file(volume: Volume, stem: str, what: Any) -> FileOut:
    if not isinstance(stem, str) or not _STEM.fullmatch(stem):
        raise InputError(f"{stem!r} cannot be a file's name; give one such as 'gas_density'")
    several = list(what) if isinstance(what, (list, tuple)) else [what]
    kind = known_kind(stem) or FieldKind("vector" if len(several) == 3 else "scalar", "")
    if kind.layout in _NOT_WRITTEN:
        raise InputError(f"files such as {stem} are RADMC-3D's own results; they are not written")
    if kind.layout == "vector" and len(several) == 1 and isinstance(what, str):
        several = _components(volume, what)
    expected = {"scalar": 1, "vector": 3}.get(kind.layout, max(len(several), 1))
    if len(several) != expected:
        raise InputError(
            f"{stem} takes {expected} field{'s' * (expected > 1)}, got {len(several)}: {what!r}"
        )
    return FileOut(stem, kind, [_column(volume, stem, kind, part) for part in several])


def _column(volume: Volume, stem: str, kind: FieldKind, what: Any) -> WrittenColumn:
    unit = parse_unit(kind.unit)
    if is_quantity(what) or (isinstance(what, Real) and not isinstance(what, bool)):
        return WrittenColumn(Expression(repr(float(plain(what, unit, stem)))), 1.0)
    if not isinstance(what, (str, Expression)):
        raise InputError(f"{stem} must be a field, an expression or a number, got {what!r}")
    expression = Expression(what)
    volume.check_names(expression)
    return WrittenColumn(expression, _factor(volume, stem, kind, expression))


def _factor(volume: Volume, stem: str, kind: FieldKind, expression: Expression) -> float:
    """Return the factor from an expression to the file's unit; 1 if the expression has no unit."""
    own = volume.expression_unit(expression)
    if own is None or not kind.unit:
        return 1.0
    from astropy import units as u

    try:
        return float(own.to(u.Unit(kind.unit)))
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{stem} must be in {kind.unit}, but {expression.text!r} is in {own}; give what is, "
            f"fields={{{stem!r}: ...}}, or say its unit: volume.set_unit(name, unit)"
        ) from error
