"""Copies of arrays whose numbers can be changed once kernels that read them are traced."""

from __future__ import annotations

import dataclasses
from typing import Any

from .jit import dr


def clone_inputs(tree: Any) -> Any:
    """Return a copy of arrays, in lists, tuples and dataclasses, in memory of its own.

    On the CPU alone: there NumPy sees the memory that kernels read.
    """
    if isinstance(tree, dr.ArrayBase):
        copy = dr.empty(type(tree), len(tree))
        copy_into(copy, tree)
        return copy
    parts = _parts(tree)
    copies = {key: clone_inputs(part) for key, part in parts.items()}
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        return dataclasses.replace(tree, **copies)
    return type(tree)(copies.values()) if parts else tree


def copy_into(copy: Any, tree: Any) -> None:
    """Put the numbers of arrays into a `clone_inputs` of some like them.

    No kernel may be running that reads it.
    """
    if isinstance(tree, dr.ArrayBase):
        # Views, in a fifth of the time that `numpy.asarray` takes.
        copy.numpy()[...] = tree.numpy()
        return
    old = _parts(copy)
    for key, part in _parts(tree).items():
        copy_into(old[key], part)


def _parts(tree: Any) -> dict[Any, Any]:
    if isinstance(tree, (list, tuple)):
        return dict(enumerate(tree))
    if dataclasses.is_dataclass(tree):
        return {f.name: getattr(tree, f.name) for f in dataclasses.fields(tree)}
    return {}
