"""What a snapshot like Gadget's tells of itself: units, cosmology, time, box, number of files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError, UnitsError
from ...units import is_quantity, parse_unit
from ..payload import inside
from .attributes import number
from .gadget_units import CodeUnits

# Types of particles by name, as most codes count them.
TYPES = {"gas": 0, "dark_matter": 1, "disk": 2, "bulge": 3, "stars": 4, "black_holes": 5}
_SEVERAL = re.compile(r"\.\d+(?=\.(hdf5|h5)$)")
_MOST_FILES = 1 << 16
# Sizes of the code's units in SWIFT, and in others.
_UNITS = {
    "length": ("Unit length in cgs (U_L)", "UnitLength_in_cm", "UnitLength_In_CGS"),
    "mass": ("Unit mass in cgs (U_M)", "UnitMass_in_g", "UnitMass_In_CGS"),
    "velocity": ("", "UnitVelocity_in_cm_per_s", "UnitVelocity_In_CGS"),
}
_TIME = "Unit time in cgs (U_t)"
_CGS = {"length": "cm", "mass": "g", "velocity": "cm / s"}


@dataclass(frozen=True)
class Header:
    """What the header tells.

    Attributes
    ----------
    units : CodeUnits
    box : array, shape (3,), or None
        Widths of the box from 0 on, in the code's unit.
    periodic : bool
    meta : dict
        Time or redshift.
    masses : array
        Of particles of each type, 0 where each has its own.
    """

    units: CodeUnits
    box: np.ndarray | None
    periodic: bool
    meta: dict[str, Any]
    masses: np.ndarray


def read_header(file: Any, given: tuple[Any, Any, Any]) -> Header:
    """Return what an open file tells; units that a user gives come first."""
    header = _attributes(file, "Header")
    told = _attributes(file, "Parameters") | header | _attributes(file, "Units")
    cosmological = _is_cosmological(file, told)
    redshift = number(told, "Redshift") or 0.0
    units = _units(told, given, 1 / (1 + redshift) if cosmological else 1.0, cosmological)
    masses = np.ravel(header.get("MassTable", np.zeros(0))).astype(np.float64)
    periodic = number(told, "PeriodicBoundariesOn")
    return Header(
        units,
        _box(told),
        cosmological if periodic is None else bool(periodic),
        _meta(told, units, redshift if cosmological else None),
        masses,
    )


def first_file(path: Path) -> Path:
    """Return the first file of a snapshot in a directory of its own; a file as it is."""
    if not path.is_dir():
        return path
    found = [*path.glob("*.0.hdf5"), *path.glob("*.0.h5")]
    return found[0] if len(found) == 1 else path


def files_of(path: Path, count: int) -> list[Path]:
    """Return all files of a snapshot.

    Parameters
    ----------
    path : Path
        One of them.
    count : int
        How many it says there are.

    Raises
    ------
    InputError
        If one is missing, or they have no numbers in their names.
    """
    if count == 1:
        return [path]
    if not 1 < count <= _MOST_FILES or not _SEVERAL.search(path.name):
        raise InputError(
            f"it says it is one of {count} files, which should be named like snapshot_000.0.hdf5"
        )
    return [inside(path.parent, _SEVERAL.sub(f".{k}", path.name)) for k in range(count)]


def _attributes(file: Any, group: str) -> dict[str, Any]:
    return dict(file[group].attrs) if group in file else {}


def _is_cosmological(file: Any, told: dict[str, Any]) -> bool:
    """Return True if lengths are comoving; where no flag tells, if time is the scale factor."""
    swift = _attributes(file, "Cosmology")
    flag = number(told | swift, "ComovingIntegrationOn", "Cosmological run")
    if flag is not None:
        return bool(flag)
    matter, time = number(told, "Omega0", "Omega_Matter"), number(told, "Time")
    redshift = number(told, "Redshift")
    if not matter or time is None or redshift is None:
        return False
    return abs(time * (1 + redshift) - 1) < 1e-3


def _units(
    told: dict[str, Any], given: tuple[Any, Any, Any], a: float, cosmological: bool
) -> CodeUnits:
    found = {kind: number(told, *(n for n in names if n)) for kind, names in _UNITS.items()}
    time = number(told, _TIME)
    if found["length"] and time:
        found["velocity"] = found["length"] / time
    for kind, unit in zip(_UNITS, given, strict=True):
        found[kind] = found[kind] if unit is None else _size(unit, kind)
    for kind, size in found.items():
        if size is not None and not size > 0:
            raise FileFormatError(f"the code's unit of {kind} must be positive, got {size}")
    h = number(told, "HubbleParam") if cosmological else None
    if not a > 0 or not (h is None or h > 0):
        raise FileFormatError(f"HubbleParam {h} or Redshift {1 / a - 1 if a else a} is impossible")
    return CodeUnits(**found, a=a, h=h or 1.0)


def _size(unit: Any, kind: str) -> float:
    from astropy import units as u

    size = unit if is_quantity(unit) else u.Quantity(1.0, parse_unit(unit))
    try:
        return float(size.to(_CGS[kind]).value)
    except u.UnitConversionError as error:
        raise UnitsError(f"{kind}_unit {unit} is no unit of {kind}") from error


def _box(told: dict[str, Any]) -> np.ndarray | None:
    size = np.ravel(told.get("BoxSize", 0.0))
    if size.dtype.kind not in "fiu" or size.size not in (1, 3):
        raise FileFormatError(f"BoxSize must be one or three numbers, got {told['BoxSize']!r}")
    box = np.broadcast_to(size.astype(np.float64), (3,))
    return box if np.isfinite(box).all() and (box > 0).all() else None


def _meta(told: dict[str, Any], units: CodeUnits, redshift: float | None) -> dict[str, Any]:
    if redshift is not None:
        return {"redshift": redshift, "scale_factor": units.a}
    time = number(told, "Time")
    if time is None:
        return {}
    if units.length is None or units.velocity is None:
        return {"time": time}
    return {"time": time * units.length / units.velocity, "time_unit": "s"}
