"""Models of RADMC-3D: ``vm.open(directory)`` reads one, `write` makes one.

RADMC-3D (Dullemond et al. 2012, ascl:1202.015) has a directory for each model, in it a file with
the grid, ``amr_grid.inp``, and one for each quantity on its cells, such as ``gas_density.inp``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .reader import RADMC3DReader

if TYPE_CHECKING:
    from .writer import write

__all__ = ["RADMC3DReader", "write"]


def __getattr__(name: str) -> Any:
    if name != "write":
        raise AttributeError(f"module {__name__} has no attribute {name!r}")
    from .writer import write  # imports expressions, which take a second

    return write
