"""The scene on the screen: plain values, changed by patches, with undo. Knows no volume's data."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ..errors import InputError
from ..media import Coefficients, Medium
from ..scene.sections import (
    build_camera,
    build_medium,
    image_options,
    projection,
    render_options,
)
from .measures import check_measures
from .slices import check_slices

Patch = list[tuple[str, Any]]
# Sections that a page may change. Others name files, which no page may.
_OPEN = ("medium", "project", "camera", "render", "image", "bookmarks", "measures", "slices")
# What pages do themselves with the numbers that they have.
_DISPLAYED = ("image.", "bookmarks", "measures", "slices")
_MOST_UNDONE = 200
# Parts of a path, and elements of a list.
_DEEPEST, _LONGEST = 6, 4096


@dataclass
class Document:
    """Settings as in a scene file, a revision that grows, and what was before.

    Attributes
    ----------
    settings : dict
        Sections ``medium`` (a list of tables), ``project``, ``camera``, ``render``, ``image``,
        ``bookmarks``, ``measures``, ``slices``.
        A medium with ``hidden = true`` stays in the list, and is not drawn.
    revision, painted : int
        Grows with every change; the newest that changed the picture's intensities.
    check_medium : callable
        Raises for a medium that does not fit the data.
    """

    settings: dict[str, Any]
    revision: int = 0
    painted: int = 0
    check_medium: Callable[[Medium], None] = lambda medium: None
    _past: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    _future: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    _gesture: str | None = None

    def __post_init__(self) -> None:
        self._check(self.settings)

    def _check(self, settings: dict[str, Any]) -> None:
        medium = check(settings)
        if medium is not None:
            self.check_medium(medium)
        if given := projection(settings.get("project", {})):
            self.check_medium(Coefficients(given["quantity"], 0))

    def apply(self, patch: Patch, label: str = "", *, moving: bool = False) -> None:
        """Change values; all of them or, after an error, none.

        Parameters
        ----------
        patch : list of (path, value)
            Such as ``("medium.0.opacity", 0.3)``; None removes a key or an element of a list.
        label : str
            What `undo` is called in a list. Changes of one gesture are one entry.
        moving : bool
            The gesture goes on.

        Raises
        ------
        InputError
            If a path does not exist, or the scene would be wrong: the message says where.
        """
        changed = copy.deepcopy(self.settings)
        for path, value in patch:
            set_path(changed, path, copy.deepcopy(value))
        self._check(changed)
        if not all(path.startswith("slices") for path, _ in patch):
            if self._gesture is None or self._gesture != label:
                self._past.append((label, self.settings))
                del self._past[:-_MOST_UNDONE]
            self._gesture = label if moving else None
            self._future.clear()
        self.settings = changed
        self.grow(all(path.startswith(_DISPLAYED) for path, _ in patch))

    def grow(self, display: bool = False) -> None:
        """Count a change; those of the display alone are the page's, and paint nothing."""
        self.revision += 1
        self.painted = self.painted if display else self.revision

    def undo(self) -> bool:
        """Return to the settings before the last gesture; False if there is none."""
        return self._go(self._past, self._future)

    def redo(self) -> bool:
        """Take back an `undo`; False if there is none."""
        return self._go(self._future, self._past)

    @property
    def labels(self) -> tuple[list[str], list[str]]:
        """What can be undone, and what redone; the next one last."""
        return [label for label, _ in self._past], [label for label, _ in self._future]

    def _go(self, source: list[Any], other: list[Any]) -> bool:
        if not source:
            return False
        label, settings = source.pop()
        other.append((label, self.settings))
        # Camera and slices are no part of what is undone: they move too often.
        here = self.settings
        self.settings = {**settings, "camera": here["camera"]}
        if "slices" in here:
            self.settings["slices"] = here["slices"]
        self._gesture = None
        self.grow()
        return True

    def look(self, camera: dict[str, Any]) -> None:
        """Set the camera, without an entry for `undo`."""
        build_camera(camera)
        self.settings = {**self.settings, "camera": camera}


def shown(settings: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the tables of the media that are drawn, as a scene file has them."""
    return [
        {key: value for key, value in table.items() if key != "hidden"}
        for table in settings["medium"]
        if not table.get("hidden")
    ]


def check(settings: dict[str, Any]) -> Medium | None:
    """Refuse settings of which no picture can be made; return the medium, if one is drawn."""
    medium: Medium | None = None
    for k, table in enumerate(settings["medium"]):
        if not isinstance(table, dict):
            raise InputError(f"[[medium]] {k + 1} must be a table, got {table!r}")
    if tables := shown(settings):
        medium = build_medium(tables)
    build_camera(settings["camera"])
    check_measures(settings.get("measures", []))
    check_slices(settings.get("slices", {}))
    if isinstance(settings.get("render", {}).get("background"), str):  # no page names a file
        raise InputError("[render] background: the explorer shows no picture as background")
    render_options(settings.get("render", {}))
    channels = 1 if projection(settings.get("project", {})) else 3
    channels = medium.channels if medium is not None and channels > 1 else channels
    image_options(settings.get("image", {}), channels)
    return medium


def set_path(settings: dict[str, Any], path: str, value: Any) -> None:
    """Set or remove the value at a path, such as ``"medium.0.opacity"``."""
    keys = path.split(".")
    if keys[0] not in _OPEN or len(keys) > _DEEPEST:
        raise InputError(f"{path!r} cannot be changed; sections are {', '.join(_OPEN)}")
    where: Any = settings
    for depth, key in enumerate(keys[:-1]):
        where = _step(where, key, path, make=depth == 0)
    last = keys[-1]
    if isinstance(where, list):
        index = _index(last, len(where), path)
        if value is None and index < len(where):
            del where[index]
        elif index == len(where) < _LONGEST:
            where.append(value)
        else:
            where[index] = value
    elif isinstance(where, dict):
        if value is None:
            where.pop(last, None)
        else:
            where[last] = value
    else:
        raise InputError(f"{path!r}: there is no such value")


def _step(where: Any, key: str, path: str, *, make: bool) -> Any:
    if isinstance(where, list):
        index = _index(key, len(where) - 1, path)
        return where[index]
    if isinstance(where, dict):
        if make:
            where.setdefault(key, {})
        if key in where:
            return where[key]
    raise InputError(f"{path!r}: there is no {key!r}")


def _index(key: str, most: int, path: str) -> int:
    if not key.isdecimal() or int(key) > most:
        raise InputError(f"{path!r}: there is no {key!r}, counted from 0")
    return int(key)
