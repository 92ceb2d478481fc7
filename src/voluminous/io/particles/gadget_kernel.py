"""Which kernel a snapshot's smoothing lengths belong to, and what the code means by them."""

from __future__ import annotations

from typing import Any

import numpy as np

# SWIFT's smoothing length is twice the standard deviation of the kernel; the radius of the support
# in it is Γ of Dehnen & Aly (2012, MNRAS 425, 1068), table 1.
_SWIFT = {
    "m4": ("cubic", 1.825742),
    "cubic": ("cubic", 1.825742),
    "m5": ("quartic", 2.018932),
    "quartic": ("quartic", 2.018932),
    "m6": ("quintic", 2.195775),
    "quintic": ("quintic", 2.195775),
    "wendland c2": ("wendland-c2", 1.936492),
    "wendland-c2": ("wendland-c2", 1.936492),
    "wendland c4": ("wendland-c4", 2.207940),
    "wendland-c4": ("wendland-c4", 2.207940),
    "wendland c6": ("wendland-c6", 2.449490),
    "wendland-c6": ("wendland-c6", 2.449490),
}
# Gadget, GIZMO and AREPO write the radius of the support; the kernel is the cubic spline.
_GADGET = ("cubic", 1.0)


def kernel_of(file: Any) -> tuple[str, float]:
    """Return the name of the kernel, and the radius of its support in the file's lengths.

    Parameters
    ----------
    file : h5py.File
    """
    scheme = file["HydroScheme"].attrs if "HydroScheme" in file else {}
    told = np.ravel(scheme.get("Kernel function", b""))[0]
    text = (told.decode("utf-8", "replace") if isinstance(told, bytes) else str(told)).lower()
    return next((found for word, found in _SWIFT.items() if word in text), _GADGET)
