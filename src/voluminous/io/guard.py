"""Errors that name the file, or the place in it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import FileFormatError, VoluminousError

# Characters of a library's own message that are shown.
_LONGEST = 400


@contextmanager
def placed(place: Any) -> Iterator[None]:
    """Put a place before the message of any error of voluminous; its class stays.

    Examples
    --------
    >>> from voluminous.errors import InputError
    >>> with placed("[camera]"):
    ...     raise InputError("incl must be finite")
    Traceback (most recent call last):
    voluminous.errors.InputError: [camera]: incl must be finite
    """
    try:
        yield
    except VoluminousError as error:
        # The message says all but what a library has raised: one traceback, not the same twice.
        raise type(error)(f"{place}: {error}") from error.__cause__


@contextmanager
def reading(path: Path, expectation: str) -> Iterator[None]:
    """Make every error that happens while `path` is read name the file.

    Raises
    ------
    VoluminousError
        Of the same class, if it was one.
    FileFormatError
        In place of any other error.
    """
    try:
        with placed(path):
            yield
    except (VoluminousError, MemoryError, ImportError):
        raise  # the file is not to blame
    except Exception as error:
        # A damaged file makes its library raise nearly anything, from KeyError to zlib.error.
        raise FileFormatError(
            f"{path}: expected {expectation}, but it is damaged, cut short or of another kind "
            f"({type(error).__name__}: {_shortened(str(error))})"
        ) from error


def _shortened(text: str) -> str:
    """Return a message of bounded length: some quote what a damaged file says is there."""
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} …"
