"""The errors voluminous raises: each says what was expected, what came, and what to do."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from os import PathLike
from typing import Any

# A noun and its attribute: "format", " that can be written".
_NOUN = re.compile(r"(.*?)((?: (?:of|that|for) .*)?)", re.DOTALL)
_PLURALS = ((r"axis$", "axes"), (r"s$", "s"), (r"(x|ch)$", r"\1es"), (r"([^aeiou])y$", r"\1ies"))


# Where a message may quote what was given: a text, a list, a long number.
_OPENS = re.compile(r"(?<!\w)(?:['\"\[{<]|\((?=[\d'\"\[(.+-]))|\d{201}")
_CLOSES = {"[": "]", "{": "}", "(": ")"}
_LONGEST = 200


class VoluminousError(Exception):
    """Base class of all errors raised on purpose by voluminous.

    Of what was given a message shows no more than 200 characters.
    """

    def __str__(self) -> str:
        return shortened(super().__str__())


def shortened(message: str) -> str:
    """Return a message without what is beyond 200 characters of each of its quotations."""
    pieces, place = [], 0
    while match := _OPENS.search(message, place):
        first, end = match.start(), _end(message, match.start())
        pieces.append(message[place : min(end, first + _LONGEST)])
        if end > first + _LONGEST:
            pieces.append(f"…{message[end - 1]}")
        place = end
    return "".join([*pieces, message[place:]])


def _end(message: str, first: int) -> int:
    """Return where a quotation that begins there ends; the next place if it is none."""
    opens = message[first]
    if opens.isdigit():
        return re.compile(r"\d+").match(message, first).end()  # type: ignore[union-attr]
    if opens not in _CLOSES:
        ends = re.compile(r">" if opens == "<" else rf"{opens}(?!\w)").search(message, first + 1)
        return ends.end() if ends else first + 1
    closes, depth = _CLOSES[opens], 0
    for match in re.compile(f"[{re.escape(opens + closes)}]").finditer(message, first):
        depth += 1 if match[0] == opens else -1
        if not depth:
            return match.end()
    return first + 1


class InputError(VoluminousError, ValueError):
    """A value that a user gave cannot be used."""


class UnitsError(InputError):
    """A unit is missing, unknown, or of the wrong physical type."""


class ExpressionError(InputError):
    """An expression cannot be parsed, or uses something the language does not have."""


class FileFormatError(InputError):
    """A file is not what it claims to be; names the file, the place and the expectation."""


class UnreachableError(InputError, OSError):
    """A server that cannot be reached, or does not give what is asked for."""


class ImmutableError(InputError, AttributeError):
    """An attribute of something that does not change was assigned or deleted."""


class UnknownNameError(VoluminousError, KeyError):
    """A name (field, scheme, colormap, key …) that does not exist; names the nearest one."""

    def __str__(self) -> str:
        # KeyError would print the repr of the message, quotes and escapes included.
        return shortened(str(self.args[0])) if self.args else ""


class MemoryNeededError(VoluminousError, MemoryError):
    """The work needs more memory than there is; says how many bytes."""


class DeviceError(VoluminousError, RuntimeError):
    """No usable compute device, or the LLVM library it needs cannot be found."""


class MissingPackageError(VoluminousError, ImportError):
    """An optional package is needed; says how to install it."""


def immutable(cls: Any, advice: str) -> None:
    """Make assigning and deleting attributes of a class raise an error that says what to do."""

    def refuse(self: Any, name: str, *value: Any) -> None:
        raise ImmutableError(f"{type(self).__name__}.{name} cannot be changed; {advice}")

    cls.__setattr__ = cls.__delattr__ = refuse


# Of lists of more names than the first only so many are shown.
_MANY, _SHOWN = 60, 12


def unknown_name(
    kind: str, name: Any, known: Iterable[str], *, other: tuple[str, Iterable[str]] = ("", ())
) -> UnknownNameError:
    """Return the error for an unknown `name`, naming the nearest among the `known` ones.

    Parameters
    ----------
    kind : str
        What the name stands for, e.g. ``"field"``.
    name : str
        The name that was given.
    known : iterable of str
        The names that exist.
    other : (str, iterable of str), optional
        Another kind, and its names: one of these may be what was meant.

    Examples
    --------
    >>> str(unknown_name("field", "densty", ["density", "temperature"]))
    "unknown field 'densty'; did you mean 'density'? known fields: density, temperature"
    """
    name = name if isinstance(name, str) else repr(name)
    names = sorted(known)
    choice = [*names, *other[1]]
    near = difflib.get_close_matches(name, choice, n=1)
    near = near or [n for n in choice if len(name) > 2 and n.startswith(name)][:1]
    which = "" if not near or near[0] in names else f"the {other[0]} "
    hint = f"; did you mean {which}{near[0]!r}?" if near else ";"
    listed = ", ".join(names) or "(none)"
    if len(names) > _MANY:
        like = difflib.get_close_matches(name, names, n=_SHOWN, cutoff=0.0)
        listed = f"{', '.join(sorted(like))} … ({len(names)} in all)"
    return UnknownNameError(f"unknown {kind} {name!r}{hint} known {_plural(kind)}: {listed}")


def check_name(kind: str, name: Any, known: Iterable[str]) -> None:
    """Raise `unknown_name` unless a name, of whatever type, is among the known ones."""
    if not isinstance(name, str) or name not in known:
        raise unknown_name(kind, name, known)


def check_flag(name: str, value: Any) -> None:
    """Refuse what is neither true nor false, such as a text."""
    if type(value).__name__ not in ("bool", "bool_"):  # Python's and NumPy's
        raise InputError(f"{name} must be True or False, got {value!r}")


def check_text(what: str, value: Any) -> None:
    """Refuse what is no text."""
    if not isinstance(value, str):
        raise InputError(f"{what} is a text, got {value!r}")


def _plural(kind: str) -> str:
    """Return the plural of a noun with its attribute: axes, keys, densities, kinds of table."""
    noun, rest = _NOUN.fullmatch(kind).groups()  # type: ignore[union-attr]
    for ending, plural in _PLURALS:
        if re.search(ending, noun):
            return re.sub(ending, plural, noun) + rest
    return f"{noun}s{rest}"


# How to make a volume of another package's data.
_TAKEN = {
    "xarray": "vm.Volume.from_xarray(data) makes a Volume of it",
    "pyvista": "vm.Volume.from_pyvista(data) makes a Volume of it",
    "yt": "vm.Volume.from_yt(data) makes a Volume of it",
    "pandas": "of points vm.Volume.from_particles(table[['x', 'y', 'z']], table['mass']) makes a "
    "Volume, of cells vm.Volume.from_xarray(table.set_index(['x', 'y', 'z']).to_xarray())",
    "numpy": "vm.Volume(vm.CartesianGrid.uniform(array.shape, (-1, 1)), density=array) holds an "
    "array",
}


def how_to_take(value: Any) -> str:
    """Return the end of a message: how to make a volume of a file or another package's data."""
    if isinstance(value, (str, PathLike)):
        return "; vm.open(path) makes one of a file"
    advice = _TAKEN.get(type(value).__module__.partition(".")[0])
    return f"; {advice}" if advice else ""
