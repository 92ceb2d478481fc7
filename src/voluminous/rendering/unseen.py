"""What of a medium a picture cannot show, and why: values that are nowhere in the volume."""

from __future__ import annotations

import copy
import functools
import warnings
from typing import Any

import numpy as np

from ..expressions import Expression
from ..expressions.interval import Interval
from ..media import Isosurface, Table
from ..media.bounds import RangeContext
from ..media.modulation import Modulation
from ..units import unit_name
from .coefficients.classify import range_of
from .job import Job, Planes

# A part of which no more than this fraction of its peak is in the volume lies outside of it …
_TAIL = 1e-3
# … if it cannot add more than this fraction of the brightest pixel, nor absorb more: a display
# shows 256 steps.
_NOTICED = 1e-4
# Of so many parts it is told what they look for.
_MOST = 4
_NOT_MET = (
    "no ray of this camera meets it where it emits or absorbs: more pixels meet what is small, and "
    "vm.render(volume) finds a medium and a camera that show what there is"
)


def warn_of_unseen(job: Job, planes: Planes, others: bool) -> None:
    """Warn of each part of the medium, and each level of it, that is nowhere in the volume.

    And where no pixel shows anything of the medium. It takes no more than the least and the largest
    value of each field, which are known, and no rays: what lies beside the frame is not told.

    Parameters
    ----------
    others : bool
        Whether there are objects besides the medium. If there are, they may be all that is meant to
        be seen.
    """
    nothing = not (planes.emission.any() or np.any(planes.transparency != 1.0))
    values = _Values(job)
    with np.errstate(all="ignore"):
        missed = _missed(values, planes)
        told = _listed([_told(part, values) for part in missed])
    everything = _count(missed) == _count(job.medium.components())
    if not (nothing or missed) or (others and (nothing or everything)):
        return
    if not nothing or everything:
        told += ". Choose values in that range; vm.auto(volume, ...) finds some"
    else:
        told = "; ".join(filter(None, [_NOT_MET, told]))
    lacks = "shows only the faintest edge" if everything else "lacks a part"
    what = "shows nothing" if nothing else lacks
    warnings.warn(f"the picture {what} of the medium: {told}", stacklevel=3)


class _Values:
    """The values of all that a medium looks at, in the whole volume."""

    def __init__(self, job: Job) -> None:
        self.volume, self.store = job.volume, job.store
        self.medium, self.parts = job.medium, job.medium.components()
        self.context = RangeContext(self.volume.unit, self.volume.expression_unit, _TAIL)

    @functools.cached_property
    def fields(self) -> dict[str, Interval]:
        """The least and the largest value of each."""
        names = dict.fromkeys(name for part in self.parts for name in _names(part))
        return {name: self._range(name) for name in names}

    def _range(self, name: str) -> Interval:
        """Return the values of a field, or of a coordinate: of these, too, looked at once."""

        def find() -> Interval:
            return range_of(self.volume, name, self.store.extremes)

        if name in self.volume or not self.kept:
            return find()
        found: Interval = self.store.kept(("range", name), find)
        return found

    @property
    def kept(self) -> bool:
        """Whether what is found is remembered with the volume."""
        return bool(self.store.is_hashed(self.medium.names))

    def outside(self) -> tuple[tuple[int, ...], ...]:
        """Return which levels of each part are nowhere; 0 for a part without levels."""
        own = self.medium.visible_key()
        if own is None or not self.kept:
            return self._outside()
        key = ("outside", own, self.store.digests(self.medium.names))
        found: tuple[tuple[int, ...], ...] = self.store.kept(key, self._outside)
        return found

    def _outside(self) -> tuple[tuple[int, ...], ...]:
        return tuple(
            tuple(k for k, one in enumerate(_singles(part)) if not self.has(one))
            if part.scalars()
            else ()
            for part in self.parts
        )

    def has(self, part: Any) -> bool:
        """Return whether more than the tail of a part is, or may be, in the volume."""
        return bool(np.any(part.visible_in(self.fields, self.context)))

    def most(self, part: Any) -> tuple[float, float]:
        """Return what a part may add to a pixel, and its optical depth, at most."""
        if isinstance(part, Isosurface):  # it is on its level, or it is not there
            return 0.0, 0.0
        found = part.ranges(self.fields, self.context)
        way = float(np.linalg.norm(np.ptp(self.volume.grid.bounds, axis=1)))
        light, depth = (
            way * max(float(np.where(v.nan, np.inf, v.size)) for v in values)
            for values in (found.emissivity, found.extinction)
        )
        return light, depth

    def text(self, expr: Expression) -> str:
        """Return between which values an expression is."""
        x: Interval = self.context.evaluate(expr, self.fields)
        unit = unit_name(self.context.unit_of(expr))
        ends = f"from {float(x.lo):.6g} to {float(x.hi):.6g}{f' {unit}' if unit else ''}"
        return f"{expr.text} is {ends} in this volume"


def _missed(values: _Values, planes: Planes) -> list[Any]:
    """Return the parts of which nothing can be seen, each with those of its levels.

    Where nothing but their tails shines these are the brightest there is, and a display shows them
    as bright as can be: all of them are missed.
    """
    outside = []
    for part, rows in zip(values.parts, values.outside(), strict=True):
        wanted = tuple(k for k in rows if not _is_dark(_singles(part)[k]))
        if wanted:
            outside.append(_with_levels(part, wanted))
    brightest = float(planes.emission.max())
    if _are_tails(outside, values):
        brightest = np.inf
    found = []
    for part in outside:
        light, depth = values.most(part)
        if depth <= _NOTICED and light <= _NOTICED * (brightest or np.inf):
            found.append(part)
    return found


def _are_tails(outside: list[Any], values: _Values) -> bool:
    """Return whether these are the whole medium, and shells that are elsewhere.

    What tables and soft gates leave of a medium may be little and what is wanted.
    """
    return _count(outside) == _count(values.parts) and not any(
        isinstance(part, Table) or values.has(_ungated(part)) for part in outside
    )


def _names(part: Any) -> tuple[str, ...]:
    """Return what a part looks at to know where it is, and in what colour."""
    if not part.scalars():
        return ()
    if isinstance(part, Isosurface):  # how steep x is on its surface does not matter
        return (*part.expr.names, *part.modulation.names)
    names: tuple[str, ...] = part.names
    return names


def _is_dark(part: Any) -> bool:
    """Return whether nothing of a part is meant to be seen: neither colour nor opacity."""
    if isinstance(part, Isosurface):  # it shows colour times opacity
        return not np.any(part.opacity)
    opacity = part.opacities if isinstance(part, Table) else getattr(part, "opacity", 1.0)
    return not (np.any(getattr(part, "color", 1.0)) or np.any(opacity))


def _singles(part: Any) -> list[Any]:
    """Return each level of a part by itself; the part, if it has none."""
    if not isinstance(part, Isosurface):
        return [part]
    return [_with_levels(part, (k,)) for k in range(len(part.levels))]


def _with_levels(part: Any, rows: tuple[int, ...]) -> Any:
    """Return some of several surfaces."""
    if not isinstance(part, Isosurface) or len(rows) == len(part.levels):
        return part
    some = copy.copy(part)
    some.levels, some.colors, some.opacities = (
        tuple(every[k] for k in rows) for every in (part.levels, part.colors, part.opacities)
    )
    return some


def _count(parts: Any) -> int:
    """Return how many parts there are, counting levels."""
    return sum(len(part.levels) if isinstance(part, Isosurface) else 1 for part in parts)


def _listed(texts: list[str]) -> str:
    """Return texts, each once, in one."""
    several = list(dict.fromkeys(texts))
    rest = len(several) - _MOST
    return "; ".join(several[:_MOST]) + (f"; and {rest} more" if rest > 0 else "")


def _told(part: Any, values: _Values) -> str:
    """Return what a part of the medium looks for, and what there is."""
    known = part.describe()
    wanted = next((known[key] for key in ("level", "center", "vmin") if key in known), None)
    listed = wanted if isinstance(wanted, (list, tuple)) else [wanted]
    at = "" if wanted is None else f" at {', '.join(_short(value) for value in listed)}"
    name, gate = f"its {known['type']}{at}", known.get("where")
    if gate and values.has(_ungated(part)):
        there = ", ".join(values.text(Expression(n)) for n in Expression(gate).names)
        return f"{name} is left out everywhere by where={gate!r}: {there}"
    there = ", ".join(values.text(expr) for expr in part.scalars())
    return f"{name}{f' where {gate}' if gate else ''} lies outside of all there is: {there}"


def _ungated(part: Any) -> Any:
    """Return a part without its gate."""
    whole = copy.copy(part)
    whole.modulation = Modulation(None, part.modulation.color, part.channels)
    return whole


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
