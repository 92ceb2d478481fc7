"""What `voluminous info` tells of a volume besides grid and fields: time, redshift, the sky."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..volume import Volume

_LONGEST, _UNIT = 100, "_unit"
# What is told of the grid that is made of them.
_TOLD_BY = ("particles",)


def describe_meta(volume: Volume) -> Iterator[str]:
    """Yield what a file told besides."""
    for key, value in volume.meta.items():
        told = _short(value)
        if told and key not in _TOLD_BY and not _is_unit(key, volume.meta):
            yield f"{key}: {told} {volume.meta.get(key + _UNIT, '')}".rstrip()
    if volume.wcs is not None:
        yield from _sky(volume.wcs)


def _is_unit(key: str, meta: Mapping[str, Any]) -> bool:
    """Return True for ``time_unit`` where there is a ``time``, beside which it is told."""
    return key.endswith(_UNIT) and key.removesuffix(_UNIT) in meta


def _short(value: Any) -> str:
    text = f"{value:.10g}" if isinstance(value, float) else str(value)
    first, *more = text.splitlines() or [""]
    return first if not more and len(first) <= _LONGEST else f"{first[:_LONGEST]} …"


def _sky(wcs: Any) -> Iterator[str]:
    for name, kind, unit, value in zip(
        wcs.wcs.ctype, wcs.world_axis_physical_types, wcs.wcs.cunit, wcs.wcs.crval, strict=True
    ):
        told = f" ({kind})" if kind else ""
        yield f"world axis {name or 'without name'}{told}: reference {value:.8g} {unit}".rstrip()
