"""A small, safe language for values computed from fields, such as ``"log10(density)"``.

The text is parsed with Python's grammar into a tree of plain nodes (no code object is ever made or
run). The same tree is then evaluated with NumPy (`NumpyOps`), traced with Dr.Jit (`DrjitOps`), or
evaluated on intervals, to know which values it can have (`IntervalOps`).

Everything is floating point and everything is per element, but for derivatives: they are fields by
names of their own (`derived_field`). Comparisons are true or false; in
arithmetic true counts 1 and false 0, and in a logical place any number but 0 is true.
"""

from typing import TYPE_CHECKING, Any

from .expression import (
    DerivedField,
    Expression,
    check_names,
    components,
    derived_field,
    required_names,
)
from .interval_ops import IntervalOps
from .ops import NumpyOps, Ops
from .parser import CONSTANTS, FUNCTIONS
from .tree import is_dex
from .units import has_units, product, resolve, shifted, times, without_unit

if TYPE_CHECKING:
    from .drjit_ops import DrjitOps

__all__ = [
    "CONSTANTS",
    "FUNCTIONS",
    "DerivedField",
    "DrjitOps",
    "Expression",
    "IntervalOps",
    "NumpyOps",
    "Ops",
    "check_names",
    "components",
    "derived_field",
    "has_units",
    "is_dex",
    "product",
    "required_names",
    "resolve",
    "shifted",
    "times",
    "without_unit",
]


def __getattr__(name: str) -> Any:
    if name == "DrjitOps":  # imported when it is used, as Dr.Jit takes long to import
        from .drjit_ops import DrjitOps

        return DrjitOps
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
