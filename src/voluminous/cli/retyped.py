"""Types of media set with ``--set`` in a scene that the command made: its numbers give way."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any


def retyped(media: list[dict[str, Any]], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the section ``medium`` without what the types in `given` do not have, if it changes.

    Parameters
    ----------
    media : list of dict
        As the command chose them, not the user.
    given : mapping
        Places and values of ``--set``; wrong ones are left for `Scene.replaced` to complain of.
    """
    from ..media import MEDIA

    kept = [
        _fitting(table, MEDIA.get(str(given.get(f"medium.{number}.type"))))
        for number, table in enumerate(media, start=1)
    ]
    return {"medium": kept} if kept != media else {}


def _fitting(table: dict[str, Any], make: Any) -> dict[str, Any]:
    """Return what of a table a type has; all of it for a type that does not exist."""
    if make is None:
        return table
    known = {"type", *inspect.signature(make).parameters}
    return {key: value for key, value in table.items() if key in known}
