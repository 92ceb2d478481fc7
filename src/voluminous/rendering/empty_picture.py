"""What of a medium a picture cannot show, and why: values that are nowhere in the volume."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..expressions import Expression
from ..expressions.interval import Interval
from ..media.contract import Medium
from ..media.ranges import RangeContext
from ..media.shell import Shell
from ..units import unit_name
from .job import RenderJob, RenderResult

# A shell of which no more than this fraction of its peak is in the volume lies outside of it …
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


def warn_of_unseen(job: RenderJob, planes: RenderResult, others: bool) -> None:
    """Warn of each shell of the medium that is nowhere in the volume.

    And where no pixel shows anything of the medium. It takes no more than the least and the largest
    value of each field, which are known, and no rays: what lies beside the frame is not told.

    Parameters
    ----------
    others : bool
        Whether there are objects besides the medium. If there are, they may be all that is meant to
        be seen.
    """
    nothing = planes.nothing
    values = _Values(job)
    with np.errstate(all="ignore"):
        missed = _missed(values, planes)
        told = _listed([_told(shells, values) for shells in missed])
    everything = _is_all(missed, job.medium)
    if not (nothing or missed) or (others and (nothing or everything)):
        return
    if not nothing or everything:
        told += ". Choose values in that range; vm.suggest_medium(volume, ...) finds some"
    else:
        told = "; ".join(filter(None, [_NOT_MET, told]))
    lacks = "shows only the faintest edge" if everything else "lacks a part"
    what = "shows nothing" if nothing else lacks
    warnings.warn(f"the picture {what} of the medium: {told}", stacklevel=4)


class _Values:
    """The values of all that a medium looks at, in the whole volume."""

    def __init__(self, job: RenderJob) -> None:
        self.volume, self.cache, self.medium = job.volume, job.cache, job.medium
        self.fields: Any = _Ranges(job)
        self.context = RangeContext(self.volume.unit, self.volume.expression_unit, _TAIL)

    def outside(self) -> list[list[Shell]]:
        parts = [part.shells() for part in self.medium.components()]
        rows = self._kept_rows(parts)
        return [[shells[k] for k in own] for shells, own in zip(parts, rows, strict=True)]

    def _kept_rows(self, parts: list[tuple[Shell, ...]]) -> tuple[tuple[int, ...], ...]:
        """Return which of the shells of each part are nowhere, remembered with the volume."""

        def find() -> tuple[tuple[int, ...], ...]:
            return tuple(
                tuple(k for k, shell in enumerate(shells) if not self.has(shell.medium))
                for shells in parts
            )

        own, names = self.medium.visible_key(), self.medium.names
        if own is None or not self.cache.statistics.is_hashed(names):
            return find()
        found: tuple[tuple[int, ...], ...] = self.cache.get_or_make(
            ("outside", own, self.cache.statistics.digests(names)), find
        )
        return found

    def has(self, medium: Medium) -> bool:
        """Return whether more than the tail of a medium is, or may be, in the volume."""
        return bool(np.any(medium.visible_in(self.fields, self.context)))

    def most(self, shell: Shell) -> tuple[float, float]:
        """Return what a shell outside may add to a pixel, and its optical depth, at most."""
        found = shell.medium.largest(self.fields, self.context)
        way = float(np.linalg.norm(np.ptp(self.volume.grid.bounds, axis=1)))
        light, depth = (
            way * max(map(float, values)) for values in (found.emissivity, found.extinction)
        )
        return light, depth

    def text(self, expr: Expression) -> str:
        x: Interval = self.context.evaluate(expr, self.fields)
        unit = unit_name(self.context.unit_of(expr))
        ends = f"from {float(x.lo):.6g} to {float(x.hi):.6g}{f' {unit}' if unit else ''}"
        return f"{expr.text} is {ends} in this volume"


class _Ranges(Mapping[str, Interval]):
    """The least and the largest value of each field: looked for when one is first asked for."""

    def __init__(self, job: RenderJob) -> None:
        self.volume, self.cache, self.names = job.volume, job.cache, job.medium.names
        self.found: dict[str, Interval] = {}

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, name: str) -> Interval:
        if name not in self.found:
            self.found[name] = self._find(name)
        return self.found[name]

    def _find(self, name: str) -> Interval:
        """Return the values of a field, or of a coordinate: of these, too, looked at once."""

        def find() -> Interval:
            return self.cache.statistics.range_of(name)

        if name in self.volume or not self.cache.statistics.is_hashed(self.names):
            return find()
        found: Interval = self.cache.get_or_make(("range", name), find)
        return found


def _missed(values: _Values, planes: RenderResult) -> list[list[Shell]]:
    """Return of each part of the medium the shells of which nothing can be seen, where any are.

    Where nothing but their tails shines these are the brightest there is, and a display shows them
    as bright as can be: all of them are missed.
    """
    outside = [[shell for shell in own if not shell.dark] for own in values.outside()]
    brightest = planes.brightest
    if _is_all(outside, values.medium) and _are_tails(outside, values):
        brightest = np.inf
    faint = _NOTICED * (brightest or np.inf)

    def is_missed(shell: Shell) -> bool:
        light, depth = values.most(shell)
        return depth <= _NOTICED and light <= faint

    missed = [[shell for shell in own if is_missed(shell)] for own in outside]
    return [own for own in missed if own]


def _is_all(shells: list[list[Shell]], medium: Medium) -> bool:
    whole = sum(len(part.shells()) or 1 for part in medium.components())
    return sum(map(len, shells)) == whole


def _are_tails(outside: list[list[Shell]], values: _Values) -> bool:
    """Return whether these are shells that are elsewhere.

    What tables and soft gates leave of a medium may be little and what is wanted.
    """
    return not any(
        shell.has_entries or values.has(shell.ungated()) for shells in outside for shell in shells
    )


def _listed(texts: list[str]) -> str:
    several = list(dict.fromkeys(texts))
    rest = len(several) - _MOST
    return "; ".join(several[:_MOST]) + (f"; and {rest} more" if rest > 0 else "")


def _told(shells: list[Shell], values: _Values) -> str:
    """Return what shells of one part of the medium look for, and what there is."""
    medium, gate = shells[0].medium, shells[0].gate
    around = [_short(shell.value) for shell in shells if shell.value is not None]
    name = f"its {medium.describe()['type']}{' at ' if around else ''}{', '.join(around)}"
    if gate and any(values.has(shell.ungated()) for shell in shells):
        there = ", ".join(values.text(Expression(n)) for n in Expression(gate).names)
        return f"{name} is left out everywhere by where={gate!r}: {there}"
    there = ", ".join(values.text(expr) for expr in medium.scalars())
    return f"{name}{f' where {gate}' if gate else ''} lies outside of all there is: {there}"


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
