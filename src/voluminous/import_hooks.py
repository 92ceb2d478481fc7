"""Something to do once another package is imported, which may be now, later, or never."""

from __future__ import annotations

import importlib.machinery
import sys
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any


def when_imported(module: str, then: Callable[[], Any]) -> None:
    """Call a function as soon as a module is imported; at once if it is already.

    The module itself is not imported. Nothing that goes wrong in the function disturbs the import.

    Parameters
    ----------
    module : str
        Name of a top-level module.
    then : callable
        Called without arguments.
    """
    if module in sys.modules:
        _quietly(then)
    elif not any(isinstance(f, _Finder) and f.module == module for f in sys.meta_path):
        sys.meta_path.insert(0, _Finder(module, then))


class _Finder:
    """Finds one module as all others would, and hears when it has been executed."""

    def __init__(self, module: str, then: Callable[[], Any]) -> None:
        self.module, self.then = module, then

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return what the others find; asking whether the module exists changes nothing."""
        if name != self.module:
            return None
        for finder in sys.meta_path:
            find = getattr(finder, "find_spec", None)
            spec = None if finder is self or find is None else find(name, path, target)
            if spec is not None:
                return self._heard(spec)
        return None

    def _heard(self, spec: importlib.machinery.ModuleSpec) -> importlib.machinery.ModuleSpec:
        """Return a spec whose loader, for this once, calls back when the module is there."""
        loader: Any = spec.loader
        execute = getattr(loader, "exec_module", None)
        if execute is None or not hasattr(loader, "__dict__"):
            return spec

        def exec_module(module: ModuleType) -> None:
            vars(loader).pop("exec_module", None)
            execute(module)
            if self in sys.meta_path:
                sys.meta_path.remove(self)
                _quietly(self.then)

        vars(loader)["exec_module"] = exec_module
        return spec


def _quietly(then: Callable[[], Any]) -> None:
    try:
        then()
    except Exception as error:
        import warnings

        warnings.warn(f"voluminous could not set itself up: {error}", stacklevel=3)
