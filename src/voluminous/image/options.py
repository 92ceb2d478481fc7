"""Options that are passed on by keyword: their names, and numbers with units."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

from ..errors import InputError, unknown_name
from ..units import as_quantity, is_quantity, plain


def check_options(kind: str, given: Iterable[str], known: Collection[str]) -> None:
    """Check that every option has a known name.

    Raises
    ------
    UnknownNameError
        For the first that has not; names the nearest.
    """
    for name in given:
        if name not in known:
            raise unknown_name(kind, name, known)


# What changes intensities on their way to the display.
_CHANGING = ("stretch", "softening", "colormap", "norm", "vmin", "vmax")


def plain_options(options: dict[str, Any], unit: Any) -> dict[str, Any]:
    """Return display options with exposure and limits as plain numbers, in the unit shown.

    Raises
    ------
    InputError
        If an option contradicts ``exposure="rgb"``.
    UnitsError
        If a limit is a quantity that cannot be converted.
    """
    if isinstance(options.get("exposure"), str):
        options = options | _as_they_are(options)
    given = {name: options.get(name) for name in ("vmin", "vmax")}
    return options | {
        name: float(plain(value, unit or None, name))
        for name, value in given.items()
        if is_quantity(as_quantity(value))
    }


def _as_they_are(options: dict[str, Any]) -> dict[str, Any]:
    if options["exposure"] != "rgb":
        raise InputError(
            f"exposure must be a number, or 'rgb' for intensities as they are, got "
            f"{options['exposure']!r}"
        )
    others = [n for n in _CHANGING if options.get(n) not in (None, "linear")]
    if others:
        raise InputError(
            f"exposure='rgb' shows intensities as they are; leave out {' and '.join(others)}, or "
            "give exposure=1"
        )
    return {"exposure": 1.0, "gamut": "clip"}
