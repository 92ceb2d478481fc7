"""Views by name: of a patient from the front, of a stack of pictures as it is leafed through."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from ..errors import InputError, check_name
from ..geometry import FIRST_INCL, FIRST_PHI, angles_towards, position_angle

# The directions of view, and the upward ones: in a patient, and in a stack of pictures, of which
# the first is nearest, with row 0 on top and column 0 on the left.
_ANATOMICAL = {
    "anterior": ("P", "S"),
    "posterior": ("A", "S"),
    "left": ("R", "S"),
    "right": ("L", "S"),
    "superior": ("I", "A"),
    "inferior": ("S", "A"),
}
_STACK, _INTO_STACK, _UP_STACK = "stack", (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
VIEWS = (*_ANATOMICAL, _STACK)
# The patient's axes: left, posterior and superior count as positive.
_AXES = {"L": (0, 1), "R": (0, -1), "P": (1, 1), "A": (1, -1), "S": (2, 1), "I": (2, -1)}


def view_angles(meta: Mapping[str, Any], view: Any = None) -> dict[str, float]:
    """Return ``incl``, ``phi`` and ``posang`` of a view of a volume.

    By default from the front, or of a stack, where the volume says so, else obliquely from above.
    """
    if view is None:
        if meta.get("orientation") is not None:
            with suppress(InputError):  # an orientation that makes no sense
                return view_angles(meta, "anterior")
        elif meta.get("y_down"):
            return view_angles(meta, _STACK)
        return {"incl": FIRST_INCL, "phi": FIRST_PHI, "posang": 0.0}
    check_name("view", view, VIEWS)
    if view == _STACK:
        if not meta.get("y_down"):
            raise InputError(
                "view='stack' is for pictures above each other, and nothing says that this volume "
                "is made of them; set volume.meta['y_down'] = True if y points down in them"
            )
        return _angles(_INTO_STACK, _UP_STACK)
    code = meta.get("orientation")
    if code is None:
        raise InputError(
            f"view={view!r} needs to know how the patient lies, which this volume does not tell; "
            "set volume.meta['orientation'] = 'LPS' if x points to the patient's left, y to the "
            "back (posterior) and z to the head (superior), or another such code"
        )
    axes = _patient(code)
    into, up = (axes[letter] for letter in _ANATOMICAL[view])
    return _angles(into, up)


def _patient(code: Any) -> dict[str, np.ndarray]:
    letters = code.upper() if isinstance(code, str) else ""
    if len(letters) != 3 or {_AXES.get(c, (None,))[0] for c in letters} != {0, 1, 2}:
        raise InputError(
            "volume.meta['orientation'] must be three letters that say where x, y and z point in "
            "the patient: L or R (left, right), P or A (back, front), S or I (head, feet), such as "
            f"'LPS'; got {code!r}"
        )
    turn = np.zeros((3, 3))
    for row, letter in enumerate(letters):
        axis, sign = _AXES[letter]
        turn[axis, row] = sign
    if np.linalg.det(turn) < 0:
        raise InputError(
            f"volume.meta['orientation'] = {code!r} is left-handed: pictures would show the "
            "patient mirrored; turn one axis of the arrays round, and its letter"
        )
    return {letter: sign * turn[axis] for letter, (axis, sign) in _AXES.items()}


def _angles(into: Any, up: Any) -> dict[str, float]:
    incl, phi = angles_towards(-np.asarray(into))
    posang = position_angle(incl, phi, np.asarray(up))
    return {"incl": incl, "phi": phi, "posang": posang}
