"""What structures count that lie in half a stretch: a panel mixes those in front of each other."""

from __future__ import annotations

from typing import Any

from ..backend import dr

# What a structure wider than a panel counts, among those narrower.
WIDE = 0.75


def core(there: Any, narrow: Any, varies: bool, like: Any) -> Any:
    """Return what a structure counts in a half of a stretch, see `Medium.cores`.

    Parameters
    ----------
    there, narrow : arrays of bool
        Whether it is in the half, and narrower than that.
    varies : bool
        Whether its colour does: a narrow one counts as two then, of which one is in front of the
        other, and panels may agree about a mixture of both.
    like : array
        Of the type of the result.
    """
    own = dr.select(narrow, like * 0.0 + (2.0 if varies else 1.0), WIDE)
    return dr.select(there, own, 0.0)
