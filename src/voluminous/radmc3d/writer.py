"""Writer for RADMC-3D models."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from contextlib import ExitStack
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import FileFormatError, InputError, UnitsError
from ..expressions import Expression
from ..files import MissingPathError, make_directory, replacing
from ..io.contract import FieldChoice
from ..io.fortran import BinaryOut, TextOut
from ..units import is_quantity, parse_unit, plain
from .grid_file import GridFile, read_grid, write_grid
from .grids import GridOut, grid_out
from .reader import FORMATS, GRID, INPUT, KINDS, FieldKind, find, known_kind

if TYPE_CHECKING:
    from ..volume import Volume

# Other codes' names of gas quantities.
_USUAL = {"density": "gas_density", "temperature": "gas_temperature", "velocity": "gas_velocity"}
_STEM = re.compile(r"[A-Za-z0-9_+-]+")


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
    >>> paths = vm.radmc3d.write(sphere, "model", {"dust_density": "1e-18 * inside"})
    >>> [path.name for path in paths]
    ['amr_grid.inp', 'dust_density.inp']
    """
    directory = Path(directory)
    files = _files(volume, fields)
    grid = grid_out(volume.grid, volume.meta.get("coordsystem"))
    if not directory.is_dir() and not directory.parent.is_dir():
        raise MissingPathError(f"the directory {directory.parent} does not exist; create it first")
    ending = ".b" if binary else "."
    paths = {directory / f"{f.stem}{ending}{f.kind.suffix[1:]}": f for f in files}
    grid_path = None if _is_there(directory, grid.file) else directory / f"{GRID}{ending}inp"
    written = [*([] if grid_path is None else [grid_path]), *paths]
    there = [old for path in written for old in find(directory, path.stem, tuple(FORMATS))]
    if there and not overwrite:
        listed = ", ".join(path.name for path in there)
        raise InputError(f"{directory} has {listed} already; give overwrite=True to replace that")
    make_directory(directory)
    # All files are written, then moved into place, so that fields and grid always match.
    with ExitStack() as stack:
        for path in written:
            with stack.enter_context(replacing(path)).open("wb") as stream:
                out = BinaryOut(stream) if binary else TextOut(stream)
                if path == grid_path:
                    write_grid(grid.file, out)
                else:
                    _write_field(volume, grid, paths[path], out)
    for old in there:
        if old not in written:  # another encoding: RADMC-3D stops if there are two
            old.unlink()
    return written


def _is_there(directory: Path, grid: GridFile) -> bool:
    there = find(directory, GRID, INPUT)
    if len(there) != 1:
        return False
    try:
        with FORMATS[there[0].suffix](there[0]) as source:
            return read_grid(source).same_cells(grid)
    except FileFormatError:
        return False


class WrittenColumn(NamedTuple):
    """An expression, and the factor that converts it to the file's unit."""

    expression: Expression
    factor: float = 1.0


class WrittenFile(NamedTuple):
    """A file to write: name without suffix, kind, and one, three or several columns."""

    stem: str
    kind: FieldKind
    columns: list[WrittenColumn]


def _write_field(volume: Volume, grid: GridOut, file: WrittenFile, out: TextOut) -> None:
    single = all(
        factor == 1 and volume.evaluate_cells(expression, 0, 1).dtype == np.float32
        for expression, factor in file.columns
    )

    def values(column: WrittenColumn) -> np.ndarray:
        values: np.ndarray = volume.evaluate(column.expression)
        scaled = values if column.factor == 1 else values.astype(np.float64) * column.factor
        return grid.flat(scaled)

    out.format(1, single)
    out.integers(grid.file.cells)
    if file.kind.layout == "species":
        out.integers(len(file.columns))
        for column in file.columns:
            out.rows(values(column))
    else:
        out.rows(*map(values, file.columns))


def _files(volume: Volume, fields: FieldChoice) -> list[WrittenFile]:
    if fields is not None and not (isinstance(fields, Mapping) and fields):
        raise InputError(
            "fields must be a table from the names of files to fields, such as "
            f"{{'gas_density': 'rho'}}, got {fields!r}"
        )
    chosen: Mapping[str, Any] = _named_alike(volume) if fields is None else fields
    return [_file(volume, stem, what) for stem, what in chosen.items()]


def _named_alike(volume: Volume) -> dict[str, list[str]]:
    """Return the fields that are named like a file of RADMC-3D; warn of the others."""
    chosen: dict[str, list[str]] = {}
    for name in volume.fields:
        stem, ending = name, ""
        if known_kind(name) is None:
            stem, _, ending = name.rpartition("_")
        kind = known_kind(stem)
        if kind is None:
            continue
        whole = kind.layout == "vector" and {*_components(volume, stem)} <= {*volume.fields}
        species = kind.layout == "species" and (not ending or ending.isdigit())
        if (
            species
            or (whole and ending in volume.grid.coordinates)
            or (kind.layout == "scalar" and not ending)
        ):
            chosen.setdefault(stem, []).append(name)
    for usual, stem in _USUAL.items():
        names = _components(volume, usual) if stem == "gas_velocity" else [usual]
        if stem not in chosen and {*names} <= {*volume.fields}:
            chosen[stem] = names
    written = {name for names in chosen.values() for name in names}
    left = [name for name in volume.fields if name not in written]
    example = f"fields={{'gas_density': {left[0]!r}}}" if left else ""
    if not chosen:
        raise InputError(
            f"none of the fields {', '.join(left) or '(there are none)'} is called like one of "
            f"RADMC-3D's files ({', '.join(KINDS)}, numberdens_…); say what they are with {example}"
        )
    if left:
        warnings.warn(
            f"left out: {', '.join(left)}; say which file a field is for with {example}",
            stacklevel=4,
        )
    return chosen


def _components(volume: Volume, vector: str) -> list[str]:
    return [f"{vector}_{axis}" for axis in volume.grid.coordinates]


def _file(volume: Volume, stem: str, what: Any) -> WrittenFile:
    if not isinstance(stem, str) or not _STEM.fullmatch(stem):
        raise InputError(f"{stem!r} cannot be a file's name; give one such as 'gas_density'")
    several = list(what) if isinstance(what, (list, tuple)) else [what]
    kind = known_kind(stem) or FieldKind("vector" if len(several) == 3 else "scalar", "")
    if kind.layout in ("levels", "frequencies"):
        raise InputError(f"files such as {stem} are RADMC-3D's own results; they are not written")
    if kind.layout == "vector" and len(several) == 1 and isinstance(what, str):
        several = _components(volume, what)
    expected = {"scalar": 1, "vector": 3}.get(kind.layout, max(len(several), 1))
    if len(several) != expected:
        raise InputError(
            f"{stem} takes {expected} field{'s' * (expected > 1)}, got {len(several)}: {what!r}"
        )
    return WrittenFile(stem, kind, [_column(volume, stem, kind.unit, part) for part in several])


def _column(volume: Volume, stem: str, unit: str, what: Any) -> WrittenColumn:
    if is_quantity(what) or (isinstance(what, Real) and not isinstance(what, bool)):
        return WrittenColumn(Expression(repr(float(plain(what, parse_unit(unit), stem)))))
    if not isinstance(what, (str, Expression)):
        raise InputError(f"{stem} must be a field, an expression or a number, got {what!r}")
    expression = Expression(what)
    volume.check_names(expression)
    own = volume.expression_unit(expression)
    if own is None or not unit:
        return WrittenColumn(expression)
    from astropy import units as u

    try:
        return WrittenColumn(expression, float(own.to(unit)))
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{stem} must be in {unit}, but {expression.text!r} is in {own}; give what is, "
            f"fields={{{stem!r}: ...}}, or say its unit: volume.set_unit(name, unit)"
        ) from error
