"""Which of a file's fields to look at first."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..volume import Volume

# What codes and people call the first thing that one looks at …
_FIRST = re.compile(r"(gas_|mass_)?density|rho|dens|(number_)?density|n|nh|n_h", re.I)
# … and what sounds like it.
_LIKE = re.compile(r".*densit(y|ies).*|.*numdens.*|rho.*|.*_rho|intensity|brightness.*|data", re.I)
# Parts of vectors say less than a scalar.
_COMPONENT = re.compile(
    r"[xyz]_.*|.*_([xyzr]|theta|phi)|(v|vel|velocity|u|b|bcc|mag|mom|e|acc)_?[xyz123]", re.I
)
# Where a cell is, and how it is counted.
_PLACE = re.compile(
    r"([xyzr]|radius|distance|theta|phi|ra|dec|lon|lat|longitude|latitude|height|altitude|"
    r"velocity|frequency|wavelength|time|level|refinement_level|grid_level|index|"
    r"cell_.*|.*_index|.*_?ids?|d[xyz]|volume)_?",
    re.I,
)
_PIECE = 1 << 20


def rank(name: str) -> int:
    """Return how late a field of this name is looked at, 0 for the first ones."""
    for number, names in enumerate((_FIRST, _LIKE)):
        if names.fullmatch(name):
            return number
    return 2 + (_COMPONENT.fullmatch(name) is not None) + 2 * (_PLACE.fullmatch(name) is not None)


def first_field(volume: Volume) -> str | None:
    """Return the field to look at first; None if there is none.

    It is called density, or something like it; else it is the first that is neither part of a
    vector nor a coordinate. Constant fields come last. Of fields that are not in memory yet only
    those are read that come before.
    """
    ranked = sorted(volume.fields, key=rank)
    found = next((name for name in ranked if varies(volume.array(name))), None)
    return found if found is not None else next(iter(ranked), None)


def varies(array: np.ndarray) -> bool:
    """Return True if there are two different finite values."""
    flat, seen = array.reshape(-1), None
    for start in range(0, flat.size, _PIECE):
        piece = flat[start : start + _PIECE]
        good = piece[np.isfinite(piece)]
        if good.size:
            seen = good[0] if seen is None else seen
            if (good != seen).any():
                return True
    return False
