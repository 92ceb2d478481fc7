"""What yt knows of a data set besides its cells."""

from __future__ import annotations

from typing import Any


def meta_of(ds: Any) -> dict[str, Any]:
    """Return what is known of a data set besides its cells."""
    meta: dict[str, Any] = {"dataset": str(ds), "code": str(ds.dataset_type)}
    time: Any = getattr(ds, "current_time", None)
    if hasattr(time, "to"):
        meta |= {"time": float(time.to("s")), "time_unit": "s"}
    if getattr(ds, "cosmological_simulation", 0):
        meta["redshift"] = float(ds.current_redshift)
    return meta
