"""RADMC-3D's files, rules and words, for comparison with it and for users who come from it.

RADMC-3D (Dullemond et al. 2012, ascl:1202.015) has a folder for each model: ``vm.open(folder)``
reads one, `write` makes one, the command ``voluminous radmc3d`` draws one by its own words. What
lower rooms find by name, a scheme, a reader and a tracer of pixels, is registered here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..packages import REGISTERED

if TYPE_CHECKING:
    from .writer import write

__all__ = ["write"]


def _scheme() -> Any:
    from .olson_kunasz import OlsonKunasz

    return OlsonKunasz()


def _reader() -> Any:
    from .reader import RADMC3DReader

    return RADMC3DReader()


def _tracer() -> Any:
    from .flux_conserving import FluxConserving

    return FluxConserving


REGISTERED["scheme"]["olson-kunasz"] = _scheme
REGISTERED["reader"]["radmc3d"] = _reader
REGISTERED["tracer"]["radmc3d"] = _tracer


def __getattr__(name: str) -> Any:
    if name != "write":
        raise AttributeError(f"module {__name__} has no attribute {name!r}")
    from .writer import write  # imports expressions, which take a second

    return write
