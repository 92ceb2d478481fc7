"""Microscope channels: their names, colours and display windows, stored in ``volume.meta``.

``meta["channels"]`` is ``{field: {"label": str, "color": [r, g, b], "window": [low, high]}}`` with
one entry for each field that is a channel; an entry omits what the file does not give. Colours are
sRGB from 0 to 1; a window gives the field values that are shown black and in full colour.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from .names import field_name

Channel = dict[str, Any]
# Image rows run downwards: the volume's y axis points down on the screen, and z away.
Y_DOWN = {"y_down": True}


def channel(label: Any = "", color: Any = None, window: Any = None) -> Channel:
    """Return the entry of a channel, from three numbers from 0 to 255 and two window ends."""
    entry: Channel = {"label": str(label).strip()} if label and str(label).strip() else {}
    if color is not None and len(color) == 3:
        entry["color"] = [round(min(max(int(c), 0), 255) / 255, 4) for c in color]
    if window is not None and len(window) == 2:
        low, high = (float(v) for v in window)
        if math.isfinite(low) and math.isfinite(high) and low < high:
            entry["window"] = [low, high]
    return entry


def channel_fields(channels: Sequence[Mapping[str, Any]], numbered: Sequence[str]) -> list[str]:
    """Return the field names: channel labels, or numbered names.

    All are numbered if two labels, or the field names made from them, are equal.
    """
    labels = [str(entry.get("label", "")) for entry in channels]
    labels = (labels + [""] * len(numbered))[: len(numbered)]
    names = [field_name(t) if t else n for t, n in zip(labels, numbered, strict=True)]
    return names if len(set(names)) == len(names) else list(numbered)


def channel_meta(entries: Iterable[tuple[str, Mapping[str, Any]]]) -> dict[str, Any]:
    """Return the `meta` of fields and their channels; empty if the file gives no channel data."""
    result = {name: dict(entry) for name, entry in entries}
    return {"channels": result} if any(result.values()) else {}


def of_samples(count: int) -> list[Channel]:
    """Return entries for the samples of a pixel; three or more begin with red, green and blue."""
    primaries = [channel(color=[255 * (k == n) for k in range(3)]) for n in range(3)]
    return [*primaries, *[{}] * (count - 3)] if count > 2 else [{}] * count
