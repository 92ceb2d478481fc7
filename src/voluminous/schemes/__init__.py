"""How ONE segment is solved: one file per scheme, one contract (`schemes.contract`)."""

from __future__ import annotations

from typing import Any

from ..errors import check_name
from .first_order import FirstOrder
from .olson_kunasz import OlsonKunasz
from .one_panel import OnePanel
from .post_classified import PostClassified
from .second_order import SecondOrder

SCHEMES = {scheme.name: scheme for scheme in (PostClassified, SecondOrder, FirstOrder, OlsonKunasz)}


def get_scheme(name: Any, *, controlled: bool = True) -> Any:
    """Return the scheme with this name; a scheme object is returned as it is.

    If errors need not be controlled, the cheaper form of a scheme that can.

    Raises
    ------
    UnknownNameError
        If there is no such scheme.
    """
    if hasattr(name, "solve"):
        return name
    check_name("scheme", name, SCHEMES)
    if name == OnePanel.name and not controlled:
        return OnePanel()
    return SCHEMES[name]()
