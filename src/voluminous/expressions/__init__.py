"""A small, safe language for values computed from fields, such as ``"log10(density)"``.

The text is parsed with Python's grammar into a tree of plain nodes (no code object is ever made or
run). The same tree is then evaluated with NumPy (`NumpyOps`), traced with Dr.Jit (`DrjitOps`), or
evaluated on intervals, to know which values it can have (`IntervalOps`).

Everything is floating point and everything is per element, but for derivatives: they are fields by
names of their own (`derived_field`). Comparisons are true or false; in
arithmetic true counts 1 and false 0, and in a logical place any number but 0 is true.
"""

from .drjit_ops import DrjitOps
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
