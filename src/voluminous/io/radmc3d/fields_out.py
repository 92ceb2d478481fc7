"""Which fields go into which of RADMC-3D's files, and in which unit."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError, UnitsError
from ...expressions import Expression
from ...units import is_quantity, parse_unit, plain
from .known import Kind, known_kind, known_stems

if TYPE_CHECKING:
    from ...volume import Volume

# What other codes call the quantities of a gas.
_USUAL = {"density": "gas_density", "temperature": "gas_temperature", "velocity": "gas_velocity"}
_STEM = re.compile(r"[A-Za-z0-9_+-]+")
_NOT_WRITTEN = ("levels", "frequencies")


@dataclass(frozen=True)
class Column:
    """An expression, and what it is multiplied by to be in the unit of a file."""

    expression: Expression
    factor: float

    def is_single(self, volume: Volume) -> bool:
        """Return True for values in single precision."""
        return self.factor == 1 and volume.evaluate_cells(self.expression, 0, 1).dtype == np.float32

    def values(self, volume: Volume) -> NDArray[np.floating[Any]]:
        """Return the values on the cells."""
        found: NDArray[np.floating[Any]] = volume.evaluate(self.expression)
        return found if self.factor == 1 else found.astype(np.float64) * self.factor


@dataclass(frozen=True)
class FileOut:
    """A file to write.

    Attributes
    ----------
    stem : str
        Its name without ending.
    kind : Kind
    columns : list of Column
        One; three of a vector; one per species.
    """

    stem: str
    kind: Kind
    columns: list[Column]


def files_out(volume: Volume, fields: Any) -> list[FileOut]:
    """Return the files to write.

    Parameters
    ----------
    volume : Volume
    fields : None or mapping
        As for `write`.

    Raises
    ------
    InputError, UnknownNameError, UnitsError
        If something that is asked for cannot be written.
    """
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
        listed = ", ".join(known_stems())
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
    kind = known_kind(stem) or Kind("vector" if len(several) == 3 else "scalar", "")
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


def _column(volume: Volume, stem: str, kind: Kind, what: Any) -> Column:
    unit = parse_unit(kind.unit)
    if is_quantity(what) or (isinstance(what, Real) and not isinstance(what, bool)):
        return Column(Expression(repr(float(plain(what, unit, stem)))), 1.0)
    if not isinstance(what, (str, Expression)):
        raise InputError(f"{stem} must be a field, an expression or a number, got {what!r}")
    expression = Expression(what)
    volume.check_names(expression)
    return Column(expression, _factor(volume, stem, kind, expression))


def _factor(volume: Volume, stem: str, kind: Kind, expression: Expression) -> float:
    """Return what brings an expression into the file's unit; one without unit is in it."""
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
