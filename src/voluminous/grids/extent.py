"""How long domains may be: products of three lengths are computed with, in double precision."""

from __future__ import annotations

import numpy as np

from ..errors import InputError

# Volumes, and volumes times densities, must be within 1e-308 to 1e308.
_SHORTEST, _LONGEST = 1e-100, 1e100


def check_extent(**axes: np.ndarray) -> None:
    """Refuse domains that are too small or too large for double precision.

    Parameters
    ----------
    **axes : array
        The walls along each axis that is a length.

    Raises
    ------
    InputError
        If a domain is shorter than 1e-100 along one of them, or walls are beyond 1e100.
    """
    for name, edges in axes.items():
        if np.abs(edges).max() > _LONGEST or edges[-1] - edges[0] < _SHORTEST:
            raise InputError(
                f"the domain must be between {_SHORTEST:g} and {_LONGEST:g} long, and its walls "
                f"within {_LONGEST:g}; {name} runs from {edges[0]:g} to {edges[-1]:g}. Give "
                "lengths in another unit, e.g. in that of the domain's size"
            )
