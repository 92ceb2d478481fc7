"""Numbers in place of what only a volume can tell: ``path_length="auto"``, units of gates."""

from __future__ import annotations

import copy
import functools
from typing import Any

import numpy as np

from ..expressions import Expression
from ..media import Medium
from ..volume import Volume
from .checks import check_medium, check_volume
from .gates import with_plain_gates
from .profile import Profile
from .samples import pieces
from .thickness import thicknesses


def calibrate(medium: Medium, volume: Volume) -> Medium:
    """Return a medium with numbers in place of ``path_length="auto"``, and of units in ``where=``.

    Each length becomes the median thickness of the medium's shell in this volume, so that one
    crossing of the shell shows its colour and its opacity. The same volume gives the same number,
    on every machine.

    Parameters
    ----------
    medium : Medium
        Any medium; also a sum.
    volume : Volume
        In which thicknesses are measured.

    Returns
    -------
    Medium
        Path lengths are plain numbers in the volume's unit, and so are numbers in conditions such
        as ``where="velocity_z > 5 km/s"``. What has neither in it is returned as it is.

    Raises
    ------
    InputError
        If the one is no medium or the other no volume.
    UnknownNameError
        If a medium looks at a field that does not exist.
    UnitsError
        If a number in a condition has a unit that does not fit what it is compared with.

    Notes
    -----
    The rule is that of `thicknesses`: effective width in x over gradient of x, weighted by area. A
    shell that is nowhere in the volume gets the shortest side of the domain.

    Examples
    --------
    >>> import voluminous as vm
    >>> core = vm.models.prestellar_core(32)
    >>> shell = vm.Gaussian("log10(density)", 3.5, 0.05, 1.0, 0.1, path_length="auto")
    >>> f"{vm.calibrate(shell, core).path_length:.2g} cm"
    '4.2e+16 cm'
    """
    check_medium("calibrate", medium)
    check_volume("calibrate", "second", volume)
    medium = with_plain_gates(medium, volume)
    parts = [p for p in medium.components() if _is_open(p)]
    if not parts:
        return medium
    lengths: dict[int, float] = {}
    for expr in dict.fromkeys(_scalar(p) for p in parts):
        same = [p for p in parts if _scalar(p) == expr]
        found = thicknesses(volume, expr, _profiles(same, volume, expr))
        lengths.update({id(p): shell.length for p, shell in zip(same, found, strict=True)})
    return medium.with_each(lambda part: _with_length(part, lengths.get(id(part))))


def _is_open(medium: Medium) -> bool:
    return isinstance(medium.path_length, str)


def _scalar(medium: Medium) -> Expression:
    (expr,) = medium.scalars()
    return expr


def _profiles(media: list[Any], volume: Volume, expr: Expression) -> list[Profile]:
    volume.check_names(expr)
    unit = volume.expression_unit(expr)
    extent = functools.cache(functools.partial(extent_of, volume, expr))
    return [Profile(*medium.profile(unit, extent)) for medium in media]


def extent_of(volume: Volume, expr: Expression) -> tuple[float, float]:
    """Return the least and the greatest finite value of an expression; zeros if there is none."""
    found = [piece.x[~np.isnan(piece.x)] for piece in pieces(volume, expr)]
    least = [float(x.min()) for x in found if x.size]
    greatest = [float(x.max()) for x in found if x.size]
    return (min(least), max(greatest)) if least else (0.0, 0.0)


def _with_length(medium: Medium, length: float | None) -> Any:
    if length is None:
        return medium
    other: Any = copy.copy(medium)
    other.path_length = length
    return other
