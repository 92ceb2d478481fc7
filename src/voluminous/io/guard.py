"""Errors that name the file, or a place in it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from traceback import walk_tb
from typing import Any

from ..errors import FileFormatError, MemoryNeededError, UnitsError, VoluminousError
from ..files import Opening, unchanged

# Python errors that mean a damaged file, besides the libraries' exception classes.
_DAMAGE = (OSError, EOFError, UnicodeDecodeError)
_OWN = ("builtins", "voluminous", "numpy", "yt.", "unyt.")
# Number of characters shown of a library's message.
_LONGEST = 400


@contextmanager
def placed(place: Any) -> Iterator[None]:
    """Prefix the message of any voluminous error with a place; its class is unchanged.

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
        # The message is complete except for a library's exception: show one traceback, not two.
        text = str(error) if str(error).startswith(f"{place}: ") else f"{place}: {error}"
        raise type(error)(text) from error.__cause__


@contextmanager
def reading(path: Path | str, expectation: str, opened: Opening | None = None) -> Iterator[None]:
    """Add the file name to every error raised while `path` is read; it must be as it was opened."""
    try:
        with placed(path), unchanged(opened or (Path(), 0, [])):
            yield
    except (VoluminousError, ImportError):
        raise  # not the file's fault
    except MemoryError as error:
        raise MemoryNeededError(
            f"{path}: there is not enough memory ({error}); read a coarser copy, or fewer fields"
        ) from error
    except Exception as error:
        if type(error).__module__.startswith("astropy.units"):
            raise UnitsError(f"{path}: {error}; give other units") from error
        raise FileFormatError(f"{path}: expected {expectation}, but {_blame(error)}") from error


@contextmanager
def by_library(name: str) -> Iterator[None]:
    """Attribute any exception from a library to the file: libraries can read valid files."""
    try:
        yield
    except (VoluminousError, MemoryError, ImportError):
        raise
    except NameError:  # a program error, regardless of the file
        raise
    except (FileNotFoundError, PermissionError) as error:
        raise FileFormatError(f"a file cannot be opened ({error})") from error
    except Exception as error:
        raise FileFormatError(
            f"it is damaged, cut short or of another kind: {name} says {type(error).__name__}: "
            f"{str(error)[:400]}"
        ) from error


def _blame(error: Exception) -> str:
    # Some messages quote the contents of a damaged file.
    text = str(error) if len(str(error)) <= _LONGEST else f"{str(error)[:_LONGEST]} …"
    message = f"{type(error).__name__}: {text}"
    if isinstance(error, (FileNotFoundError, PermissionError)):
        return f"a file cannot be opened ({message})"
    modules = [frame.f_globals.get("__name__", "") for frame, _ in walk_tb(error.__traceback__)]
    of_hdf5 = isinstance(error, RuntimeError) and modules[-1].startswith("h5py")
    if of_hdf5 or isinstance(error, _DAMAGE) or not type(error).__module__.startswith(_OWN):
        return f"it is damaged, cut short or of another kind ({message})"
    culprit = "yt" if any(name.startswith("yt.") for name in modules) else "voluminous"
    return f"{culprit} failed on it with {message}. If the file is sound, please report it"
