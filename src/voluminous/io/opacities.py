"""Reads opacities of dust: RADMC-3D's files, optool's, and plain tables."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files import as_path, missing
from ..physics.opacity import Opacity
from .guard import reading
from .radmc3d.encodings import TextFile, fortran_numbers

_COMMENTS = (b"#", b"!", b";")
_STEMS = ("dustkappa_", "dustkapscatmat_")
_MATRIX = "dustkapscatmat"


def read(path: str | PathLike[str], name: str | None = None) -> Opacity:
    """Return the opacity in a file; see `Opacity.open`."""
    path = as_path(path)
    if not path.is_file():
        raise missing(path)
    with reading(path, "a table of opacities"), TextFile(path) as source:
        return _table(source, _name(path) if name is None else name)


def _name(path: Path) -> str:
    return next((path.stem[len(s) :] for s in _STEMS if path.stem.startswith(s)), path.stem)


def _table(source: TextFile, name: str) -> Opacity:
    tokens = source.tokens("a table of opacities")
    while tokens[0].startswith(_COMMENTS):
        tokens = source.tokens("a table of opacities")
    head, columns, rows = b"", len(tokens), 0
    if columns == 1:  # RADMC-3D's formats
        (number,) = fortran_numbers(tokens[0], source.line).tolist()
        matrix = source.path.name.startswith(_MATRIX)
        if number not in ((1,) if matrix else (1, 2, 3)):
            raise FileFormatError(f"line {source.line}: expected format 1, 2 or 3, got {number:g}")
        columns = 4 if matrix else int(number) + 1
        (rows,) = source.integers(1, "the number of wavelengths")
        if matrix:
            source.integers(1, "the number of angles")
    else:
        head = b" ".join(tokens) + b"\n"
    rest = [line for line in source.file.readlines() if not line.lstrip().startswith(_COMMENTS)]
    if rows:  # what follows them, such as a scattering matrix, is not read
        rest = [line for line in rest if line.strip()][:rows]
    values = fortran_numbers(head + b"".join(rest), source.line)
    rows = rows or len(values) // columns
    if not 2 <= columns <= 4 or rows < 1 or len(values) != rows * columns:
        raise FileFormatError(
            f"expected {rows} wavelengths with {columns} columns (2 to 4: wavelength in micron, "
            f"absorption, scattering, asymmetry), found {len(values)} numbers"
        )
    waves, *others = np.reshape(values, (rows, columns)).T
    given = dict(zip(("absorption", "scattering", "asymmetry"), others, strict=False))
    return Opacity(waves, **given, name=name)
