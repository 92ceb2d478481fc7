"""Numbers in place of what only a volume can tell: path lengths, ranges of colours, units."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..expressions import Expression
from ..media import Medium
from ..volume import Volume
from .checks import check_medium, check_volume
from .colors import with_color_ranges
from .plain import in_plain_numbers
from .profile import Profile
from .samples import pieces
from .thickness import thicknesses


def calibrate(medium: Medium, volume: Volume) -> Medium:
    """Return a medium with numbers in place of all that was left to be measured in a volume.

    Each ``path_length="auto"`` becomes the median thickness of the medium's shell in this volume,
    so that one crossing of the shell shows its colour and its opacity; what is not given of the
    range of a `ColorBy` or `Colormap` such that 99 % of what the medium shows, by volume, is
    between. Units in expressions are converted. The same volume gives the same numbers, on every
    machine.

    Parameters
    ----------
    medium : Medium
        Any medium; also a sum.
    volume : Volume
        In which thicknesses are measured.

    Returns
    -------
    Medium
        Path lengths are plain numbers in the volume's unit, and so are numbers in expressions such
        as ``where="velocity_z > 5 km/s"``. What has none of all these is returned as it is.

    Raises
    ------
    InputError
        If the one is no medium or the other no volume, or there is no range of colours.
    UnknownNameError
        If a medium looks at a field that does not exist.
    UnitsError
        If the unit of an expression cannot be derived.

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
    volume.refresh()  # derivatives of fields that were changed in place
    return calibrated(medium, volume, lambda *exprs: {})


def calibrated(medium: Medium, volume: Volume, known: Callable[..., dict[Any, Any]]) -> Medium:
    """Return the same, with what was measured before for other pictures of the volume.

    Measured for every picture anew it took ten times as long as the picture itself: 0.75 s of 0.8
    for a colormap in 4 million cells, 120 x 120 pixels.

    Parameters
    ----------
    medium, volume
        As for `calibrate`.
    known : callable
        Returns what is known of expressions in this volume: it is looked up there, and added.
    """
    plain = in_plain_numbers(medium, volume)
    return _with_lengths(with_color_ranges(plain, volume, known), volume, known)


def _with_lengths(medium: Medium, volume: Volume, known: Callable[..., dict[Any, Any]]) -> Medium:
    """Return a medium with numbers for all path lengths; itself if none is open."""
    parts = [p for p in medium.components() if _is_open(p)]
    if not parts:
        return medium
    lengths: dict[int, float] = {}
    for expr in dict.fromkeys(_scalar(p) for p in parts):
        same = [p for p in parts if _scalar(p) == expr]
        found = _lengths(same, volume, expr, known(expr))
        lengths.update({id(p): length for p, length in zip(same, found, strict=True)})
    return medium.with_each(lambda part: _with_length(part, lengths.get(id(part))))


def _is_open(medium: Medium) -> bool:
    return isinstance(medium.path_length, str)


def _scalar(medium: Medium) -> Expression:
    (expr,) = medium.scalars()
    return expr


def _lengths(
    media: list[Any], volume: Volume, expr: Expression, known: dict[Any, Any]
) -> list[float]:
    profiles = _profiles(media, volume, expr, known)
    missing = {p.key: p for p in profiles if p.key not in known}
    if missing:
        found = thicknesses(volume, expr, list(missing.values()))
        known.update({key: shell.length for key, shell in zip(missing, found, strict=True)})
    return [known[p.key] for p in profiles]


def _profiles(
    media: list[Any], volume: Volume, expr: Expression, known: dict[Any, Any]
) -> list[Profile]:
    volume.check_names(expr)
    unit = volume.expression_unit(expr)

    def extent() -> tuple[float, float]:
        if "extent" not in known:
            known["extent"] = extent_of(volume, expr)
        found: tuple[float, float] = known["extent"]
        return found

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
    return medium.changed(path_length=length)
