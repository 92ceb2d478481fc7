"""Measures on the screen: distances, angles, and statistics of the cells that a medium shows.

A measure is a table: ``kind`` "distance" or "angle" with ``points`` (two; or three, the vertex in
the middle), or "cells" with ``expr`` and what is counted: ``where`` (a condition), and ``clip`` (a
region as a text) or the corners ``low`` and ``high`` of a box. Numbers are in the volume's unit.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from ..cameras import Camera
from ..errors import InputError
from ..expressions import Expression
from ..measuring import measure, probe
from ..regions import Box
from ..units import described, is_quantity, plain, unit_name
from ..volume import Volume
from .painter import Shot

_POINTS = {"distance": 2, "angle": 3}
# Measures, and letters of a text beside one.
_MOST, _LONGEST = 50, 100
# A point of which less light comes to the observer cannot be seen.
_HIDDEN = 0.1
_RAY_OPTIONS = ("scheme", "precision", "device", "clip")


def check_measures(measures: Any) -> None:
    """Check a list of measures."""
    for k, one in enumerate(measures if isinstance(measures, list) else [measures, None]):
        good = isinstance(one, dict) and k < _MOST
        if good and one.get("kind") == "cells":
            corners = [one[side] for side in ("low", "high") if side in one]
            texts = [one.get("expr"), one.get("where", ""), one.get("clip", "")]
            good = all(isinstance(text, str) for text in texts)
            good &= _are_points(corners or [[0, 0, 0]] * 2, 2) and not (corners and texts[2])
        elif good:
            good = _are_points(one.get("points"), _POINTS.get(one.get("kind"), 0))
        if not good:
            raise InputError(
                f"measures.{k} must be a distance (two points), an angle (three) or cells (expr, "
                f"and where, or low and high), of {_MOST} at most; got {one!r:.200}"
            )


def _are_points(points: Any, count: int) -> bool:
    try:
        array = np.asarray(points, float)
    except (TypeError, ValueError):
        return False
    return array.shape == (count, 3) and bool(np.all(np.isfinite(array)))


def statistics(
    volume: Volume, one: dict[str, Any], memory: Any, progress: Callable[[int, int], None] | bool
) -> dict[str, Any]:
    """Return what `measure` says of cells: numbers and units as JSON has them."""
    what = {"value": one["expr"], **{axis: axis for axis in "xyz"}}
    result = measure(volume, what, memory=memory, progress=progress, **_chosen(one))
    if not result.cells:
        raise InputError("no cell fulfils that, or is in the box")
    made: dict[str, Any] = {"cells": result.cells, "missing": result.missing.get("value", 0)}
    parts = {"min": result.minima, "max": result.maxima, "mean": result.means}
    values = {name: part.get("value") for name, part in parts.items()}
    values |= {"total": result["value"], "volume": result.volume}
    for name, value in values.items():
        made[name], made[f"{name}_unit"] = _number(value)
    made["point"] = [_number(result.means[axis])[0] for axis in "xyz"]
    return made


def _chosen(one: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of `measure` that say which cells count."""
    made: dict[str, Any] = {key: one[key] for key in ("where", "clip") if one.get(key)}
    return {**made, "clip": Box(one["low"], one["high"])} if "low" in one else made


def _number(value: Any) -> tuple[float | None, str]:
    if value is None or not np.isfinite(value):
        return None, ""
    return (float(value.value), unit_name(value.unit)) if is_quantity(value) else (float(value), "")


def script_of(measures: list[dict[str, Any]], unit: str, memory: Any) -> str:
    """Return the lines of Python that compute the same numbers; `unit` is that of lengths."""
    lines = ["", "import numpy as np", ""]
    for one in measures:
        if one["kind"] == "distance":
            lines += ["a, b = {}, {}".format(*one["points"])]
            lines += ["distance = np.linalg.norm(np.subtract(b, a))"]
            lines += [f"print('distance', distance, {unit!r})"]
        elif one["kind"] == "angle":
            first, vertex, last = one["points"]
            lines += [f"vertex = {vertex}", f"a, b = np.subtract([{first}, {last}], vertex)"]
            lines += ["angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))"]
            lines += ["print('angle', angle, 'deg')"]
        else:
            options = [repr(one["expr"])]
            options += [f"{key}={one[key]!r}" for key in ("where", "clip") if one.get(key)]
            if "low" in one:
                options.append(f"clip=vm.regions.Box({one['low']}, {one['high']})")
            options += [f"memory={memory!r}"] * bool(memory)
            lines += ["cells = vm.measure(", *(f"    {o}," for o in ("volume", *options)), ")"]
            lines += ["print(cells, cells.means, cells.minima, cells.maxima)"]
    return "\n".join([*lines, ""])


def hidden_points(shot: Shot, points: Any, memory: Any) -> list[bool]:
    """Return which points are hidden: less than a tenth of their light comes to the observer."""
    points = np.asarray(points, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) > 3 * _MOST:
        raise InputError(f"points must be up to {3 * _MOST} triples of numbers")
    hidden, grid = [False] * len(points), shot.volume.grid
    if shot.medium is None or shot.projection:  # nothing hides anything
        return hidden
    options = {key: value for key, value in shot.options.items() if key in _RAY_OPTIONS}
    options |= {"tolerance": None, "memory": memory, "progress": False}
    u, v, _ = shot.camera.project(points.T, grid)
    ahead = shot.camera.lines_of_sight(points.T, grid).T
    for k, cell in enumerate(grid.locate(points)):
        if cell < 0:
            continue
        ray = probe(shot.volume, shot.medium, shot.camera, at=(u[k], v[k]), **options)
        if len(ray):
            # Not by the surface on which the point lies.
            beside = 2.0 * float(grid.cell_sizes(cell, cell + 1).max())
            place = 0.5 * (ray.begin[0] + ray.end[0]) + (points[k] - ray.position[0]) @ ahead[k]
            depth = np.append(0.0, ray.depth.min(axis=1))
            front = np.interp(place - beside, np.append(ray.begin[0], ray.end), depth)
            hidden[k] = bool(np.exp(-front) < _HIDDEN)
    return hidden


def marks_of(lines: Any, camera: Camera, volume: Volume) -> list[tuple[np.ndarray, str]]:
    """Return lines in space and their texts as lines on the image plane, if none is behind it."""
    marks = []
    for points, words in lines:
        u, v, depth = camera.project(np.asarray(points, float).T, volume.grid)
        if camera.parallel or np.all(depth > 0):
            marks.append((np.stack([u, v], axis=1), str(words)[:_LONGEST]))
    return marks


def shown_where(medium: Any, volume: Volume) -> str:
    """Return the condition on cells that a medium shows: half of its maximum, or inside a surface.

    That is where the extinction is at least half of its largest value (of a medium that takes away
    nothing, the emissivity); inside an isosurface is where x is at least the lowest level; labels
    show those that are visible. The empty string stands for all cells.

    Raises
    ------
    InputError
        If this kind of medium has no such condition.
    """
    table = medium.describe()
    if "visible" in table:
        seen = [n for n, on in zip(medium.numbers, table["visible"], strict=True) if on]
        return " or ".join(f"{table['expr']} == {n}" for n in seen) or "false"
    if "extinction" in table:
        return _strong(table, volume)
    if any(f.colors is not None and f.colors.is_open for f in medium.features()):
        medium = medium.calibrated(volume)
    expr = Expression(table["expr"]) if "expr" in table else None
    unit = None if expr is None else volume.expression_unit(expr)
    if "level" in table:
        ends = [(min(plain(one, unit, "level") for one in medium.levels), None)]
    elif (profile := medium.profile(unit, lambda: (-np.inf, np.inf))) is not None:
        ends = _at_half(*profile)
    else:
        raise InputError(
            f"what {type(medium).__name__} shows has no limit to measure at; give a condition, "
            "such as 'density > 1'"
        )
    x = table["expr"]
    x = x if re.fullmatch(r"\w+(\([^()]*\))?", x) else f"({x})"
    numbers = [[e if e is None else f"{e:.6g}" for e in pair] for pair in ends]
    sides = [
        f"{low} <= {x} <= {high}" if low and high else f"{x} >= {low}" if low else f"{x} <= {high}"
        for low, high in numbers
        if low or high
    ]
    parts = [" or ".join(sides), table.get("where") or ""]
    several = all(parts)
    return " and ".join(f"({part})" if several else part for part in parts if part)


def _at_half(values: np.ndarray, heights: np.ndarray) -> list[tuple[Any, Any]]:
    """Return between which values a profile, zero outside, is at half of its maximum or above."""
    values, heights = np.pad(values, 1, mode="edge"), np.pad(heights, 1)
    half = 0.5 * heights.max()
    turns = [
        None if np.isinf(low) or np.isinf(high) else low + (half - a) / (b - a) * (high - low)
        for (low, high), (a, b) in zip(pairwise(values), pairwise(heights), strict=True)
        if (a >= half) != (b >= half)
    ]
    return list(zip(turns[::2], turns[1::2], strict=True))


def _strong(table: dict[str, Any], volume: Volume) -> str:
    for name in ("extinction", "emissivity"):
        expr = table[name]
        if isinstance(expr, str) and Expression(expr).names:
            largest = measure(volume, {"x": expr}).maxima["x"]
            return f"({expr}) >= {described(0.5 * largest)}"
    raise InputError("coefficients that are no expression of a field show all cells alike")
