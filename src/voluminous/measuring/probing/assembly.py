"""From the record of a ray to what a user is told of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...media.bounds import RangeContext
from ...rendering.coefficients.emission_unit import before
from ...units import parse_unit, unit_name
from .fields import in_cells, looked_at, on_the_ray, units_of
from .follow import Followed, ProbeJob
from .place import Place
from .result import Probe


def assembled(
    job: ProbeJob, volume: Any, place: Place, found: Followed, more: Any, background: np.ndarray
) -> Probe:
    """Return a probe.

    Parameters
    ----------
    volume : Volume
        As the camera sees it, with all that is missing.
    found : Followed
        What was recorded, from the observer on.
    more : list of Expression
        What else is asked for.
    background : array, shape (channel,)
    """
    rows, grid = found.rows, volume.grid
    begin, end = rows["begin"][:, 0], rows["end"][:, 0]
    position = found.origin + 0.5 * (begin + end)[:, None] * found.direction
    cell = _cells(job, position, rows)
    hidden = _hidden(job, cell)
    fields, scalars, units = _values(job, volume, rows, cell, hidden, more)
    light = job.medium.intensity_unit(RangeContext(volume.unit, volume.expression_unit))
    units |= {"length": unit_name(volume.unit), "intensity": unit_name(parse_unit(light))}
    per_length = 1.0 / grid.scale
    b, theta = _mixed(found, "emission"), rows["transparency"]
    gathered, arriving = folded(b, theta, background.astype(np.float64))
    return Probe(
        begin=begin,
        end=end,
        position=position,
        cell=cell,
        index=_index(grid, cell),
        level=np.where(cell >= 0, grid.levels.reshape(-1)[cell], 0),
        hidden=hidden,
        fields=fields,
        scalars=scalars,
        j=_mixed(found, "j") * per_length,
        alpha=rows["alpha"] * per_length,
        tau=rows["tau"],
        theta=theta,
        b=b,
        depth=np.cumsum(rows["tau"], axis=0),
        gathered=gathered,
        arriving=arriving,
        background=np.array(background, dtype=np.float64),
        **_ending(found, background),
        stopped=found.stopped,
        pixel=place.pixel,
        at=place.at,
        axes=tuple(grid.coordinates),
        units=units,
        provenance={**job.provenance(), "camera": job.camera.describe()},
    )


def folded(
    b: np.ndarray, theta: np.ndarray, background: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what segments add up to from the front on, and from the back.

    Pairs (b, θ) compose: (b₁ + θ₁ b₂, θ₁ θ₂).

    Parameters
    ----------
    b : array, shape (n, c)
    theta : array, shape (n, 1) or (n, c)
    background : array, shape (c,)

    Returns
    -------
    gathered : array, shape (n, c)
        Seen by the observer of the first, the first two, … segments.
    arriving : array, shape (n, c)
        In front of each segment, of all behind, and of the background.
    """
    before = np.cumprod(np.vstack([np.ones_like(theta[:1]), theta[:-1]]), axis=0)
    gathered = np.cumsum(before * b, axis=0)
    arriving, light = np.empty_like(b), background
    for k in reversed(range(len(b))):
        light = b[k] + theta[k] * light
        arriving[k] = light
    return gathered, arriving


def _mixed(found: Followed, what: str) -> np.ndarray:
    """Return emissions in channels: in kernels they may be those of a medium's parts."""
    return np.asarray(found.numbers.mix(list(found.rows[what].T)), dtype=np.float64)


def _ending(found: Followed, background: np.ndarray) -> dict[str, np.ndarray]:
    emission = found.numbers.mix([np.asarray(v) for v in found.path.emission])
    through = np.stack(found.path.transparency)
    total = before(background, emission, through)
    depth = np.stack(found.path.depth)
    return {"intensity": total, "transparency": through, "optical_depth": depth}


def _cells(job: ProbeJob, position: np.ndarray, rows: dict[str, np.ndarray]) -> np.ndarray:
    """Return the grid's own cells: schemes on interpolated fields walk between their centres."""
    if job.scheme.place == "field" and job.hidden is None:
        return np.asarray(job.volume.grid.locate(position), dtype=np.int64)
    return rows["cell"][:, 0].astype(np.int64)


def _hidden(job: ProbeJob, cell: np.ndarray) -> np.ndarray:
    if job.hidden is None:
        return np.zeros(len(cell), bool)
    return np.asarray((job.hidden.words[cell >> 5] >> (cell & 31).astype(np.uint32)) & 1 == 1)


def _index(grid: Any, cell: np.ndarray) -> np.ndarray | None:
    if not grid.is_structured:
        return None
    index = np.stack(np.unravel_index(np.maximum(cell, 0), grid.shape), axis=-1)
    return np.where(cell[:, None] >= 0, index, -1)


def _values(
    job: ProbeJob,
    volume: Any,
    rows: dict[str, np.ndarray],
    cell: np.ndarray,
    hidden: np.ndarray,
    more: Any,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], dict[str, str]]:
    names, expressions = looked_at(job.medium)
    recorded = {n[6:]: v[:, 0] for n, v in rows.items() if n.startswith("field ")}

    def values(expr: Any) -> np.ndarray:
        if job.scheme.place != "field":
            return in_cells(volume, expr, cell)
        return np.where(hidden, np.nan, on_the_ray(expr, recorded))

    fields = {e.text: values(e) for e in names}
    fields |= {e.text: in_cells(volume, e, cell) for e in more if e.text not in fields}
    scalars = {e.text: values(e) for e in expressions if e.text not in fields}
    return fields, scalars, units_of(volume, [*names, *more, *expressions])
