"""Panels of rays on which fields are known polynomials."""

from __future__ import annotations

import numpy as np

from voluminous.backend import from_host
from voluminous.backend.functions import horner
from voluminous.media.context import Context
from voluminous.media.panel import Panel


def panel_of(backend, **cubics):
    """Return a panel on which fields are polynomials of s."""
    context = Context(backend.Float, backend.opaque)
    rows = {
        name: [from_host(backend.Float, np.asarray(c, backend.dtype)) for c in own]
        for name, own in cubics.items()
    }

    def at(s):
        return {name: horner(backend.Float(s), own) for name, own in rows.items()}

    return Panel([at(s) for s in (0.0, 0.5, 1.0)], context, backend.Float(1.0), between=at)
