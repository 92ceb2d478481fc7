"""How one segment is solved: one file per scheme, one contract (`schemes.base`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..errors import check_name
from ..packages import REGISTERED
from .base import Scheme
from .first_order import FirstOrder
from .post_classified import PostClassified
from .pre_integrated import PreIntegrated
from .second_order import SecondOrder

SCHEMES: dict[str, Callable[[], Scheme]] = {
    **{s.name: s for s in (PostClassified, PreIntegrated, SecondOrder, FirstOrder)},
    **REGISTERED["scheme"],
}


def get_scheme(name: Any, *, controlled: bool = True) -> Scheme:
    """Return the scheme of a name; a `Scheme` is returned as it is.

    Without error control ``"post-classified"`` is ``"pre-integrated"``.
    """
    if isinstance(name, Scheme):
        return name
    check_name("scheme", name, SCHEMES)
    if name == PostClassified.name and not controlled:
        name = PreIntegrated.name
    return SCHEMES[name]()
