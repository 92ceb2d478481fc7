"""Names of options that are passed on by keyword."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from ..errors import unknown_name


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
