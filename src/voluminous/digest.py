"""Hashes of contents: of arrays, and of all that decides how a picture looks."""

from __future__ import annotations

import dis
import functools
import hashlib
import importlib.util
import inspect
import os
import pickle
import re
import secrets
import sys
import types
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

import numpy as np

from .packages import version
from .value import Value

# Bytes that one thread hashes at a time: a few milliseconds, long beside handing them out.
_PART = 8 << 20
# More do not make memory faster.
_MOST_THREADS = 8
# What functions are identified by, and what is made of them: not names, nor where code stands.
_CODE = "code names varnames freevars cellvars flags argcount posonlyargcount kwonlyargcount"
_FUNCTIONS = ("__self__", "__func__", "fget", "fset", "fdel", "func", "__wrapped__")
_MADE_OF: Any = (types.MethodType, staticmethod, classmethod, property, functools.cached_property)
_MADE_OF += (functools._lru_cache_wrapper,)
# Instructions that read global variables.
_READS = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS")


def digest(values: np.ndarray) -> bytes:
    """Return 64 bits of XXH3 for each 8 MiB of a contiguous array.

    One thread reads 30 GB/s, two 55 (512³ numbers: 18 ms and 9 ms, for every picture).
    """
    import xxhash

    data = values.data
    if values.nbytes <= _PART or (threads := min(os.cpu_count() or 1, _MOST_THREADS)) == 1:
        return bytes(xxhash.xxh3_64_digest(data))
    plain = data.cast("B")
    parts = (plain[first : first + _PART] for first in range(0, values.nbytes, _PART))
    with ThreadPoolExecutor(threads) as pool:
        return b"".join(pool.map(xxhash.xxh3_64_digest, parts))


def content_key(*values: Any) -> str:
    """Return a hash of what values contain: the same in all processes, for one version.

    Numbers count to the last bit, arrays with all elements, objects with what a pickle has of them.
    Functions count with their code, defaults, closures, and the global variables and functions that
    they read; those of installed packages with their names. Files that a function opens do not.

    What cannot be identified again, such as a lock or an open file, is warned of; its key is a new
    one each time.
    """
    hashed = hashlib.sha256()
    try:
        _Contents(types.SimpleNamespace(write=hashed.update)).dump((version(), *values))
    except Exception as error:  # pickling runs code of others
        warnings.warn(
            f"something that is drawn with cannot be identified again ({type(error).__name__}: "
            f"{str(error)[:200]}): whatever was drawn with it is drawn anew by the next call",
            stacklevel=3,
        )
        return secrets.token_hex(16)
    return hashed.hexdigest()[:32]


class _Contents(pickle.Pickler):
    """Writes objects as pickles that are never read, functions and classes with all they do."""

    def __init__(self, file: Any) -> None:
        super().__init__(file, protocol=4)
        self.fast = True  # equal objects count as one object does
        self.seen: dict[int, Any] = {}

    def reducer_override(self, value: Any) -> Any:
        """Return what is written of an object; NotImplemented for what others pickle."""
        kind: Any = type(value)
        if isinstance(value, (type, types.FunctionType, types.ModuleType)):
            name = getattr(value, "__qualname__", "")
            module = str(value.__module__) if name else value.__name__
            if "<locals>" not in name and _is_installed(module):
                return NotImplemented if isinstance(value, type) else _written(module, name)
            if id(value) in self.seen:
                return _written("seen", list(self.seen).index(id(value)))
            self.seen[id(value)] = value
            if isinstance(value, types.FunctionType):
                return _written(_of_function(value))
            return _written(_of_class(value))
        if isinstance(value, types.CodeType):
            fixed = (sorted(map(repr, c)) if type(c) is frozenset else c for c in value.co_consts)
            return _written(list(fixed), *(getattr(value, f"co_{name}") for name in _CODE.split()))
        if isinstance(value, _MADE_OF):
            return _written(kind.__name__, [getattr(value, name, None) for name in _FUNCTIONS])
        if kind in (np.ndarray, np.memmap) and not value.dtype.hasobject:
            data = np.ascontiguousarray(value).view("u1")
            return _written(value.dtype, value.shape, digest(data))
        if callable(fingerprint := getattr(value, "fingerprint", None)):  # a volume
            return _written("contents", fingerprint())
        if hasattr(value, "decompose") and hasattr(value, "bases"):  # a unit, which knows itself
            plain = value.decompose()
            return _written(str(value), plain.scale, list(map(str, plain.bases)), plain.powers)
        if callable(header := getattr(value, "to_header_string", None)):  # of the sky
            return _written("wcs", header(relax=True), value.array_shape)
        colors: Any = sys.modules.get("matplotlib.colors")
        if colors and isinstance(value, colors.Colormap):
            ends = value.get_under(), value.get_over(), value.get_bad()
            return _written("colormap", value(np.arange(value.N)), *ends)
        if colors and isinstance(value, colors.Normalize):
            return _written(kind, {k: v for k, v in vars(value).items() if k != "callbacks"})
        ours = kind.__module__.startswith("voluminous.") and kind.__reduce__ is object.__reduce__
        if isinstance(value, Value) or (ours and hasattr(value, "__dict__")):
            state = list((value.__reduce_ex__(4)[2] or {}).items())
            if isinstance(value, Value):  # what is private is made of the arguments
                state = [(n, v) for n, v in state if n == "_given" or n[0] != "_"]
            found, lazy = inspect.getattr_static, functools.cached_property  # likewise
            return _written(kind, [p for p in state if not isinstance(found(kind, p[0], 0), lazy)])
        return NotImplemented


def _written(*parts: Any) -> Any:
    return tuple, (parts,)


def _of_class(value: Any) -> list[Any]:
    members = vars(value).items()
    relevant = [(n, v) for n, v in members if n != "_abc_impl" and (callable(v) or n[:2] != "__")]
    return [value.__name__, getattr(value, "__bases__", ()), relevant]


def _of_function(value: types.FunctionType) -> list[Any]:
    """Return what a function does: its code, and the values of all variables that it reads."""
    code = value.__code__
    used = {n: value.__globals__[n] for n in _names(code, _READS) if n in value.__globals__}
    for name in _names(code, ("IMPORT_NAME",)):
        used[name] = name if _is_installed(name) else importlib.import_module(name)
    for name, cell in zip(code.co_freevars, value.__closure__ or (), strict=True):
        with suppress(ValueError):  # it is empty
            used[name] = cell.cell_contents
    return [code, value.__defaults__, value.__kwdefaults__, vars(value), used]


def _names(code: types.CodeType, kinds: tuple[str, ...]) -> list[str]:
    names = [step.argval for step in dis.get_instructions(code) if step.opname in kinds]
    inner = [_names(c, kinds) for c in code.co_consts if isinstance(c, types.CodeType)]
    return sum(inner, names)


@functools.cache
def _is_installed(module: str) -> bool:
    top = module.partition(".")[0]
    if top in ("voluminous", *sys.stdlib_module_names):
        return True
    with suppress(ImportError, ValueError):  # it has no file
        spec = importlib.util.find_spec(top)
        place = str(spec and (spec.submodule_search_locations or spec.origin))
        return "main__" not in top and re.search("(site|dist)-packages", place) is not None
    return False
