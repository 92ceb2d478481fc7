"""Boxes: the outline of a grid's domain, of its patches, and of what is refined."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..colormaps import is_name_and_alpha
from ..errors import InputError
from .contract import Layers, SceneObject
from .lattices import level_count
from .lines import Lines
from .outlines import outline
from .values import joined, options_of
from .view import View


class Boxes(SceneObject):
    """The outline of a grid and of its levels; see `boxes`."""

    def __init__(self, grid: Any, levels: Any, merged: bool | None, **style: Any) -> None:
        super().__init__(**{key: style[key] for key in ("depth", "channel", "relative")})
        self.grid, self.levels, self.merged, self.style = grid, _checked(levels), merged, style
        self.colors, self.width, self.opacity = (style[k] for k in ("colors", "width", "opacity"))
        self._found: tuple[Any, Any, np.ndarray] | None = None
        if merged not in (None, True, False):
            raise InputError(f"merged must be true or false, got {merged!r}")
        Lines(np.zeros((1, 2, 3)), **{**style, "colors": _first(self.colors)})

    def layers(self, view: View) -> Layers | None:
        grid = view.grid if self.grid is None else self.grid
        if self._found is None or self._found[0] is not grid:  # found once for many pictures
            self._found = (grid, *self._lines(grid))
        _, lines, level = self._found
        unit = 1.0 if grid.unit is None else grid.unit
        places = [line * unit for line in lines] if isinstance(lines, list) else lines * unit
        return Lines(places, **{**self.style, "colors": _of_levels(self.colors, level)}).layers(
            view
        )

    def _lines(self, grid: Any) -> tuple[Any, np.ndarray]:
        """Return polylines, and which of the levels that are drawn each belongs to."""
        merged = grid.patches is None if self.merged is None else self.merged
        levels = _chosen(self.levels, level_count(grid))
        parts = [outline(grid, level, merged) for level in levels]
        which = [np.full(sum(map(len, part)), k) for k, part in enumerate(parts)]
        groups = [group for part in parts for group in part]
        straight = all(group.shape[1] == 2 for group in groups)
        lines = np.concatenate(groups) if straight else [line for g in groups for line in g]
        return lines, np.concatenate(which)

    def describe(self, most: float = math.inf) -> dict[str, Any]:
        return {"type": "boxes", **options_of(boxes, self, most)}


def boxes(
    volume: Any = None,
    colors: Any = 1.0,
    *,
    levels: Any = None,
    merged: bool | None = None,
    width: Any = 1.0,
    opacity: float = 1.0,
    depth: str = "true",
    channel: int | None = None,
    relative: bool = True,
) -> Boxes:
    """Return the outlines of a grid as lines: of the domain, of patches, of what is refined.

    Of a Cartesian grid it is a box; of spherical and cylindrical ones the arcs and circles where
    they end, and where all around there is no end, four meridians and the equator.

    Parameters
    ----------
    volume : Volume, optional
        Default: the one that is rendered.
    colors : optional
        As for `Lines`; a list has one for each level that is drawn, or more.
    levels : int or sequence of int, optional
        Which levels to draw: 0 is the domain (and the coarsest patches), k what is refined k
        times or more. Those that a grid has not are left out. Default: all of them.
    merged : bool, optional
        Draw the edges of all that is refined to a level as one body; else of each patch of a
        `PatchGrid`, or of each cell that is split. Default: each patch, but trees as one body.
    width, opacity, depth, channel
        As for `Lines`.
    relative : bool
        Colours count in units of the picture's brightest pixel.

    Raises
    ------
    InputError
        If levels are no whole numbers from 0, or `volume` is none; when they are drawn, if a grid
        has none of them, or if there are fewer colours.
    """
    if volume is not None and not hasattr(volume, "grid"):
        raise InputError(
            f"boxes: expected a vm.Volume, or colors=…, got {type(volume).__name__} first"
        )
    grid = None if volume is None else volume.grid
    style: dict[str, Any] = {"colors": joined(colors), "width": width, "opacity": opacity}
    style |= {"depth": depth, "channel": channel, "relative": relative}
    return Boxes(grid, levels, merged, **style)


def _checked(levels: Any) -> Any:
    if levels is None:
        return None
    several = isinstance(levels, (Sequence, np.ndarray))
    given = list(levels) if several else [levels]
    whole = all(isinstance(k, (int, np.integer)) and not isinstance(k, bool) for k in given)
    if not whole or not given or min(given) < 0:
        raise InputError(f"levels must be a whole number from 0, or several, got {levels!r}")
    return [int(k) for k in given] if several else int(levels)


def _chosen(levels: Any, count: int) -> list[int]:
    wanted = [levels] if isinstance(levels, int) else levels
    found = [k for k in range(count) if wanted is None or k in wanted]
    if not found:
        raise InputError(f"levels={levels!r}: the grid has levels 0 to {count - 1}")
    return found


def _several(colors: Any) -> bool:
    return not (isinstance(colors, str) or is_name_and_alpha(colors)) and (
        np.ndim(colors) == 2 or (np.ndim(colors) == 1 and isinstance(colors[0], str))
    )


def _first(colors: Any) -> Any:
    return colors[:1] if _several(colors) else colors


def _of_levels(colors: Any, level: np.ndarray) -> Any:
    if not _several(colors) or len(colors) == 1:
        return colors
    if len(colors) <= level.max():
        raise InputError(f"colors: there are {len(colors)}, for {level.max() + 1} levels drawn")
    return [colors[k] for k in level] if isinstance(colors, (list, tuple)) else colors[level]
