"""Views by their anatomical names, from which way a patient's axes run in a volume."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import InputError, check_name
from ..first_view import FIRST_INCL, FIRST_PHI
from ..rotation import angles_towards, position_angle

STACK = "stack"
# Where the observer is, and what is on top of the picture, as letters of `meta["orientation"]`.
_SIDES = {
    "anterior": "AS",
    "posterior": "PS",
    "left": "LS",
    "right": "RS",
    "superior": "SA",
    "inferior": "IA",
}
VIEWS = (*_SIDES, STACK)
_OPPOSITE = {"L": "R", "R": "L", "P": "A", "A": "P", "S": "I", "I": "S"}


def view_angles(meta: Mapping[str, Any], view: str | None) -> tuple[float, float, float]:
    """Return inclination, azimuth and position angle of a view, in degrees.

    Parameters
    ----------
    meta : mapping
        Of the volume. ``"orientation"`` has three letters: where +x, +y and +z point in a patient.
    view : {"anterior", "posterior", "left", "right", "superior", "inferior", "stack"} or None
        Where the observer is; ``"stack"`` shows the first slice in front and its first row on top,
        as ImageJ does. None: anterior or stack for data of that kind, else obliquely above.

    Raises
    ------
    InputError
        If the volume does not say which way its axes run.
    UnknownNameError
        If there is no such view.
    """
    axes = _axes_of(meta.get("orientation"))
    if view is None:
        if axes is None and not meta.get("y_down"):
            return FIRST_INCL, FIRST_PHI, 0.0
        view = STACK if axes is None else "anterior"
    check_name("view", view, VIEWS)
    if view == STACK:
        towards, up = np.array([0.0, 0.0, -1.0]), np.array([0.0, -1.0, 0.0])
    elif axes is None:
        raise InputError(
            f"view={view!r} needs to know how the patient lies: set "
            'volume.meta["orientation"] to three letters that say where +x, +y and +z point, '
            f'such as "LPS" (left, posterior, superior); it is {meta.get("orientation")!r}'
        )
    else:
        towards, up = (axes[letter] for letter in _SIDES[view])
    incl, phi = angles_towards(towards)
    return incl, phi, position_angle(incl, phi, up)


def _axes_of(code: Any) -> dict[str, np.ndarray] | None:
    """Return where each letter points in the volume; None if they do not make sense."""
    axes: dict[str, np.ndarray] = {}
    for letter, axis in zip(str(code).upper(), np.eye(3), strict=False):
        if letter in _OPPOSITE:
            axes |= {letter: axis, _OPPOSITE[letter]: -axis}
    return axes if len(axes) == 6 and len(str(code)) == 3 else None
