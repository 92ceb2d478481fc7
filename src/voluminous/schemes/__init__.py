"""How ONE segment is solved: one file per scheme, one contract (`schemes.contract`)."""

from __future__ import annotations

from typing import Any

from ..errors import unknown_name
from .first_order import FirstOrder
from .olson_kunasz import OlsonKunasz
from .second_order import SecondOrder

SCHEMES = {scheme.name: scheme for scheme in (FirstOrder, SecondOrder, OlsonKunasz)}


def get_scheme(name: Any) -> Any:
    """Return the scheme with this name; a scheme object is returned as it is.

    Raises
    ------
    UnknownNameError
        If there is no such scheme.
    """
    if hasattr(name, "solve"):
        return name
    if name not in SCHEMES:
        raise unknown_name("scheme", str(name), SCHEMES)
    return SCHEMES[name]()
