"""Type names for the arguments and results of traced functions.

Dr.Jit's types depend on device, precision and derivatives, and the same function may get NumPy
arrays or plain numbers. Type checkers therefore treat these names as Any; they tell a reader which
kind of number is expected.
"""

from __future__ import annotations

from typing import Any, TypeAlias

Float: TypeAlias = Any
"""Floating-point numbers, one per ray or cell."""
Int: TypeAlias = Any
"""Whole numbers: cells, levels, steps."""
Mask: TypeAlias = Any
"""Truth values, one per ray or cell."""
