"""Type names for the arguments and results of traced functions.

Type checkers treat them as Any: Dr.Jit's types depend on device, precision and derivatives, and the
same function may get NumPy arrays or plain numbers.
"""

from __future__ import annotations

from typing import Any, TypeAlias

Float: TypeAlias = Any
"""Floating-point numbers, one per ray or cell."""
Int: TypeAlias = Any
"""Whole numbers: cells, levels, steps."""
Mask: TypeAlias = Any
"""Truth values, one per ray or cell."""
