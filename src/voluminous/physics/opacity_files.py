"""Reads opacities of dust: RADMC-3D's files, optool's, and plain tables."""

from __future__ import annotations

import re
from os import PathLike
from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files import as_path, missing
from ..io.fortran import TextFile, before_comment, fortran_numbers
from ..io.guard import reading
from .opacity import Opacity

_WHAT = "a table of opacities"
_REAL = re.compile(rb"[-+]?[\d.].*")
_STEMS = ("dustkappa_", "dustkapscatmat_")
_MATRIX = "dustkapscatmat"


def read(path: str | PathLike[str], name: str | None = None) -> Opacity:
    """Return the opacity in a file; see `Opacity.open`."""
    path = as_path(path)
    if not path.is_file():
        raise missing(path)
    with reading(path, _WHAT), TextFile(path) as source:
        return _table(source, _name(path) if name is None else name)


def _name(path: Path) -> str:
    return next((path.stem[len(s) :] for s in _STEMS if path.stem.startswith(s)), path.stem)


def _table(source: TextFile, name: str) -> Opacity:
    row = before_comment(source.tokens(_WHAT))
    while not row:
        row = before_comment(source.tokens(_WHAT))
    columns, rows, found = len(row), 0, []
    if columns == 1 or (row[0].isdigit() and not _REAL.fullmatch(row[1])):  # RADMC-3D's formats
        (number,) = fortran_numbers(row[0], source.line).tolist()
        matrix = source.path.name.startswith(_MATRIX)
        if number not in ((1,) if matrix else (1, 2, 3)):
            raise FileFormatError(f"line {source.line}: expected format 1, 2 or 3, got {number:g}")
        columns = 4 if matrix else int(number) + 1
        (rows,) = source.integers(1, "the number of wavelengths")
        if matrix:
            source.integers(1, "the number of angles")
    else:
        found.append(fortran_numbers(b" ".join(row), source.line))
    row = []
    for line, text in enumerate(source.file, start=source.line + 1):
        row += before_comment(text.split())
        if len(row) >= columns:  # with a format, further columns are not read, as in Fortran
            found.append(fortran_numbers(b" ".join(row[: columns if rows else None]), line))
            row = []
        if len(found) == rows:  # what follows, such as a scattering matrix, is not read
            break
    count = sum(map(len, found)) + len(row)
    rows = rows or count // columns
    if not 2 <= columns <= 4 or rows < 1 or count != rows * columns:
        raise FileFormatError(
            f"expected {rows} wavelengths with {columns} columns (2 to 4: wavelength in micron, "
            f"absorption, scattering, asymmetry), found {count} numbers"
        )
    waves, *others = np.concatenate(found).reshape(rows, columns).T
    given = dict(zip(("absorption", "scattering", "asymmetry"), others, strict=False))
    return Opacity(waves, **given, name=name)
