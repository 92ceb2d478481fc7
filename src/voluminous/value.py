"""Immutable values: media, cameras, objects in pictures, regions; `Value.replace` makes others."""

from __future__ import annotations

import copy
import functools
import inspect
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from .errors import ImmutableError, unknown_name
from .notebook import page, table
from .units import is_quantity, unit_of

Self = TypeVar("Self", bound="Value")


class Value:
    """Base of immutable classes.

    Attributes are set in ``__init__``; later only those whose names begin with an underscore.
    """

    _given: dict[str, Any]
    _done: bool = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "__init__" in vars(cls):
            cls.__init__ = _remembering(cls.__init__)  # type: ignore[method-assign]

    def arguments(self) -> dict[str, Any]:
        """Return the arguments it was made with, by name."""
        return dict(vars(self).get("_given", {}))

    def describe(self) -> dict[str, Any]:
        """Return the arguments as plain values, as in a scene file."""
        raise NotImplementedError

    def replace(self: Self, **changes: Any) -> Self:
        """Return another one, made with the same arguments but for these.

        Raises
        ------
        UnknownNameError
            If there is no such argument.
        """
        known = [name for name in inspect.signature(type(self)).parameters if name != "options"]
        given = self.arguments()
        for name in changes:
            if name not in known and name not in given:
                raise unknown_name("argument", name, known)
        return type(self)(**{**given, **changes})

    def changed(self: Self, **attributes: Any) -> Self:
        """Return a copy with other attributes: for what has been measured in a volume."""
        other = copy.copy(self)
        given = self.arguments()
        vars(other).update(attributes)
        vars(other)["_given"] = given | {k: v for k, v in attributes.items() if k in given}
        return other

    def __setattr__(self, name: str, value: Any) -> None:
        if self._done and not name.startswith("_"):
            self._refuse(name, f"{name}=…")
        object.__setattr__(self, name, value)

    def __delattr__(self, name: str) -> None:
        self._refuse(name, "…")

    def __repr__(self) -> str:
        shown = ", ".join(f"{name}={value!r}" for name, value in self.arguments().items())
        return f"{type(self).__name__}({shown})"

    def _swatch(self) -> str:
        return ""

    def _repr_html_(self) -> str:
        rows = [(name, value) for name, value in self.arguments().items() if value is not None]
        return page(type(self).__name__, self._swatch(), table(rows))

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other) or not self._done:
            return self is other
        return _same(self._given, other._given)

    def __hash__(self) -> int:
        if not self._done:
            return object.__hash__(self)
        plain = (v for v in self._given.values() if isinstance(v, (str, int, float)))
        return hash((type(self).__name__, *plain))

    def _refuse(self, name: str, how: str) -> None:
        kind = type(self).__name__
        raise ImmutableError(
            f"{kind}.{name} cannot be changed: {kind} objects are values; make another one: "
            f"new = old.replace({how})"
        )


def _remembering(init: Callable[..., None]) -> Callable[..., None]:
    """Return an ``__init__`` that keeps its arguments; the outermost one freezes the value."""
    signature = inspect.signature(init)

    @functools.wraps(init)
    def made(self: Any, *args: Any, **options: Any) -> None:
        if "_given" in vars(self):
            return init(self, *args, **options)
        args, options = _own(args), _own(options)
        try:
            call = signature.bind(self, *args, **options)
            call.apply_defaults()
            bound = dict(call.arguments)
        except TypeError:  # which `init` raises again
            bound = {}
        for parameter in signature.parameters.values():
            if parameter.kind is parameter.VAR_KEYWORD:
                bound |= bound.pop(parameter.name, {})
        bound.pop(next(iter(signature.parameters)), None)
        vars(self)["_given"] = bound
        init(self, *args, **options)
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        vars(self)["_done"] = True
        return None

    return made


def _own(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _own(part) for name, part in value.items()}
    if type(value) in (list, tuple):
        return type(value)(_own(part) for part in value)
    return value.copy() if isinstance(value, np.ndarray) or is_quantity(value) else value


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same(a[k], b[k]) for k in a)
    if isinstance(a, (list, tuple)) and isinstance(b, (list, tuple)):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return unit_of(a) == unit_of(b) and np.array_equal(np.asarray(a), np.asarray(b))
    return bool(a is b or a == b)
