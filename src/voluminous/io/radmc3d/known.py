"""The files that RADMC-3D knows: how values are laid out in them, and their units."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .binary import BinaryFile
from .records import RecordFile
from .text import TextFile

GRID = "amr_grid"
# Endings of names, in the order of preference: RADMC-3D stops where there is more than one.
FORMATS: dict[str, type[BinaryFile | TextFile | RecordFile]] = {
    ".binp": BinaryFile,
    ".bdat": BinaryFile,
    ".bout": BinaryFile,
    ".inp": TextFile,
    ".dat": TextFile,
    ".out": TextFile,
    ".uinp": RecordFile,
    ".udat": RecordFile,
    ".uout": RecordFile,
}
INPUT = (".binp", ".inp", ".uinp")


@dataclass(frozen=True)
class Kind:
    """What a file holds.

    Attributes
    ----------
    layout : {"scalar", "vector", "species", "levels", "frequencies"}
        One value per cell; three; one array per species; some values per cell; one array per
        frequency.
    unit : str
    ending : str
        What the name of a text file ends in.
    """

    layout: str
    unit: str
    ending: str = ".inp"


_DENSITY, _NUMBER, _INTENSITY = "g / cm3", "1 / cm3", "erg / (s cm2 Hz sr)"
_KINDS = {
    "gas_density": Kind("scalar", _DENSITY),
    "gas_temperature": Kind("scalar", "K"),
    "gas_velocity": Kind("vector", "cm / s"),
    "dust_density": Kind("species", _DENSITY),
    "dust_temperature": Kind("species", "K", ".dat"),
    "stellarsrc_density": Kind("species", _DENSITY),
    "electron_numdens": Kind("scalar", _NUMBER),
    "ion_numdens": Kind("scalar", _NUMBER),
    "microturbulence": Kind("scalar", "cm / s"),
    "escprob_lengthscale": Kind("scalar", "cm"),
    "grainalign_dir": Kind("vector", ""),
    "heatsource": Kind("scalar", "erg / (s cm3)"),
    "mean_intensity": Kind("frequencies", _INTENSITY, ".out"),
}
# Files of which there is one per molecule.
_PREFIXES = {
    "numberdens_": Kind("scalar", _NUMBER),
    "levelpop_": Kind("levels", _NUMBER, ".dat"),
}


def known_kind(stem: str) -> Kind | None:
    """Return what a file of this name (without ending) holds; None if RADMC-3D has no such file."""
    for prefix, kind in _PREFIXES.items():
        if stem.startswith(prefix) and stem != prefix:
            return kind
    return _KINDS.get(stem)


def known_stems() -> tuple[str, ...]:
    """Return the names that RADMC-3D knows."""
    return tuple(_KINDS)


def opened(path: Path) -> BinaryFile | TextFile | RecordFile:
    """Return a file, open to be read from its beginning."""
    return FORMATS[path.suffix](path)


def find(directory: Path, stem: str, suffixes: tuple[str, ...]) -> list[Path]:
    """Return the files of a name that there are, the preferred one first."""
    paths = [directory / (stem + suffix) for suffix in suffixes]
    return [path for path in paths if path.is_file()]
