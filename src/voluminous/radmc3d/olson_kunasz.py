"""RADMC-3D's second-order rule, including its branches and its cap, for comparison.

Olson & Kunasz (1987, JQSRT 38, 325) take the source function as linear in OPTICAL DEPTH, with the
optical depth by the trapezoidal rule; RADMC-3D 2.0 adds that the emission never exceeds the
optically thin trapezoid. This is not the exact solution for coefficients linear in distance
(scheme ``second-order``): it differs by 2e-4 (smooth) to 1e-1 (white noise) of the image maximum.

RADMC-3D computes ``τ - (1 - e^-τ)`` by subtraction: for τ just above 1e-6 the last bit of a path
length is 1e-9 of the image maximum. Pictures differ from RADMC-3D's by that amount.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Hashable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.functions import attenuation, horner, loop, precision_of
from ..backend.types import Float, Mask
from ..errors import InputError
from ..grids.contract import Segment
from ..grids.curvilinear.grid import SphericalGrid
from ..media.bound import Binding
from ..media.context import Context
from ..media.contract import Medium
from ..schemes.base import JAlpha, Solution, Steps, VertexScheme, VertexSource
from ..schemes.channels import Channels
from ..schemes.path import Path, empty_path, over
from ..spectral.lines import BoundLines, Lines

if TYPE_CHECKING:
    from ..grids.contract import Grid

# Below the first depth RADMC-3D takes the trapezoid's weights, below the second its emission.
_SERIES_BELOW = 1e-6
_THIN_BELOW = float(np.float32(1e-9))
# Where seven terms of the front weight's series suffice in single precision.
_SERIES_ENDS = 0.35
# Of coefficients that are differences of numbers some thousand (in single: ten) times as large.
_ROUNDING = {"single": 1e-6, "double": 1e-10}


class OlsonKunasz(VertexScheme):
    """Solve a segment as RADMC-3D's ``secondorder`` does.

    On spherical grids rays run towards the camera, in RADMC-3D's sub-steps: `cutoff` and
    `order` have no effect. Spectral lines take double precision: in single, S = j/α of faint wings
    is off by up to 5e-2.

    Parameters
    ----------
    catch_doppler_resolution : float, optional
        RADMC-3D's Doppler catching: the state of the gas is interpolated, not j and α, in steps in
        which lines shift by this part of their width. RADMC-3D has 0.2. It leaves out lines at the
        point where a ray enters the grid; here they are counted.
    """

    name = "olson-kunasz"
    order = 2

    def __init__(self, catch_doppler_resolution: float | None = None) -> None:
        resolution = catch_doppler_resolution
        if resolution is not None and not 0.0 < resolution <= 1.0:
            raise InputError(
                f"catch_doppler_resolution must be a part of a line's width, from 0 to 1, got "
                f"{resolution!r}"
            )
        self.resolution = resolution

    def steps(self, grid: Grid) -> Steps:
        radmc3d = isinstance(grid, SphericalGrid)
        return Steps("substeps", backward=True) if radmc3d else Steps("cells")

    def channels(self, medium: Medium, binding: Binding, context: Context) -> Channels | None:
        return None if self.resolution is None else GasStates(medium, binding, context)

    def needs_double(self, medium: Medium) -> bool:
        return bool(medium.sight)  # S = j/α of faint wings of lines

    def solve(
        self, segment: Segment, source: VertexSource, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        corners = segment.walk.exit_corners(segment.track, segment)
        reached = list(source.interpolate(corners, segment.active))
        if self.resolution is not None:
            gas: Any = source.channels
            return self.caught(segment, gas, carried, reached), reached
        ends = list(zip(carried, reached, strict=True))
        if not source.channels.medium.sight:  # wings of lines may differ by as much within a cell
            ends = [_without_rounding(*pair) for pair in ends]
        first, last = (source.channels.split(list(values)) for values in zip(*ends, strict=True))
        front, back = (last, first) if segment.backward else (first, last)
        return self.between(front, back, segment.length, segment.walk.scale), reached

    def caught(
        self, segment: Segment, gas: GasStates, first: list[Float], last: list[Float]
    ) -> Solution:
        """Return the solution between two states of the gas; each channel has steps of its own."""
        assert self.resolution is not None
        backward, scale, nothing = segment.backward, segment.walk.scale, type(segment.length)(0.0)
        ends = [gas.split(values) for values in (first, last)]
        found = Solution([], [], [])
        for c, count in enumerate(gas.steps(first, last, self.resolution)):
            count = dr.select(segment.active & (count > 1.0), count, 1.0)
            width, begin = 1.0 / count, _channel(ends[0], c)

            def step(
                k: Float, before: list[Float], path: Path, c: int = c, width: Float = width
            ) -> tuple[Float, list[Float], Path]:
                k = k + 1.0
                part = k * width
                state = [dr.fma(part, b - a, a) for a, b in zip(first, last, strict=True)]
                after = _channel(gas.split(state, c), 0)
                after = dr.select(part < 1.0, after, _channel(ends[1], c))
                front, back = (after, before) if backward else (before, after)
                one, other = (([x[0]], [x[1]]) for x in (front, back))
                solved = self.between(one, other, segment.length * width, scale)
                path = over(solved, path) if backward else over(path, solved)
                return k, after, path

            def going_on(k: Float, before: list[Float], path: Path, count: Float = count) -> Mask:
                return k < count

            start = nothing, begin, empty_path(type(segment.length), 1, 1)
            *_, path = loop(start, going_on, step, label="doppler steps")
            found.emission += path.emission
            found.transparency += path.transparency
            found.depth += path.depth
        return found

    def between(self, front: JAlpha, back: JAlpha, length: Float, scale: Float) -> Solution:
        (j_front, a_front), (j_back, a_back) = front, back
        depth = [0.5 * (f + b) * length for f, b in zip(a_front, a_back, strict=True)]
        weights = [_weights(tau) for tau in depth]
        emission = []
        for c, (jf, jb) in enumerate(zip(j_front, j_back, strict=True)):
            k = c if len(depth) > 1 else 0
            ends = jf, jb, a_front[k], a_back[k]
            emission.append(_emission(*ends, length, depth[k], weights[k], scale))
        return Solution(emission, [theta for theta, _, _ in weights], depth)


def _channel(coefficients: JAlpha, c: int) -> list[Float]:
    """Return j and α of one channel."""
    j, alpha = coefficients
    return [j[c], alpha[c if len(alpha) > 1 else 0]]


def _weights(tau: Float) -> tuple[Float, Float, Float]:
    return _stable_weights(tau) if precision_of(type(tau)) == "single" else _radmc_weights(tau)


def _stable_weights(tau: Float) -> tuple[Float, Float, Float]:
    """Return the weights without subtractions of nearly equal numbers.

    In single precision RADMC-3D's arithmetic would lose all digits at τ = 1e-4.
    """
    theta, mean = attenuation(tau)
    series = horner(-tau, [1.0 / math.factorial(k) for k in range(2, 10)])
    front = dr.select(tau < _SERIES_ENDS, tau * series, 1.0 - mean)
    return theta, dr.fma(tau, mean, -front), front


def _radmc_weights(tau: Float) -> tuple[Float, Float, Float]:
    """Return e^-τ and RADMC-3D's weights: differences of nearly equal numbers."""
    thin, half, e = tau <= _SERIES_BELOW, 0.5 * tau, dr.exp(-tau)
    e0 = 1.0 - e
    front = (tau - e0) / dr.select(thin, 1.0, tau)
    return (
        dr.select(thin, 1.0 - tau, e),
        dr.select(thin, half, e0 - front),
        dr.select(thin, half, front),
    )


def _emission(
    j_front: Float,
    j_back: Float,
    a_front: Float,
    a_back: Float,
    s: Float,
    tau: Float,
    weights: tuple[Float, Float, Float],
    scale: Float,
) -> Float:
    single = precision_of(type(tau)) == "single"
    # RADMC-3D's, per cm: S is zero where there is hardly any extinction.
    tiny = float(np.finfo(np.float32).tiny) if single else 1e-99 * type(tau)(scale)
    _, w_back, w_front = weights
    q = w_back * (j_back / (a_back + tiny)) + w_front * (j_front / (a_front + tiny))
    cap = 0.5 * (j_front + j_back) * s
    return dr.minimum(dr.select(tau > _THIN_BELOW, q, cap), cap)


def _without_rounding(first: Float, last: Float) -> tuple[Float, Float]:
    """Return a coefficient at both ends, zero where it is but a rounding error of the other's.

    Where a medium ends S = j/α is 0; it must not depend on whether 0 or 1e-17 is left there.
    """
    least = _ROUNDING[precision_of(type(first))] * dr.maximum(first, last)
    return dr.select(first > least, first, 0.0), dr.select(last > least, last, 0.0)


class GasStates(Channels):
    """Channels of lines, whose tables hold the state of the gas, and j and α of all else.

    Coefficients are made of it along the ray.
    """

    def __init__(self, medium: Medium, binding: Binding, context: Context) -> None:
        super().__init__(medium, binding)
        self.context, parts = context, self.bound.parts
        self.lines = [part.medium for part in parts if isinstance(part, BoundLines)]
        self.others = [part for part in parts if not isinstance(part, BoundLines)]
        self.count = sum(part.state_count for part in self.lines)
        self.count += 2 * self.emissions * bool(self.others)
        self.signed = self.count

    def in_unit(self, unit: Any) -> Channels:
        """Return the channels in other units, which `split` brings in: a table has none."""
        part = copy.copy(self)
        part.unit = np.broadcast_to(unit, self.emissions)
        return part

    def group(self, channels: slice) -> Channels:
        part = GasStates(self.medium, replace(self.binding, channels=channels), self.context)
        part.unit, part.peaks = self.unit[channels], self.peaks[channels]
        return part

    def key(self) -> Hashable:
        key = self.medium.key()
        return None if key is None else ("states", key)

    def table_values(self, fields: dict[str, Float], context: Context) -> list[Float]:
        found = [v for part in self.lines for v in part.states(fields, context)]
        if self.others:
            samples = [part.coefficients(fields, context) for part in self.others]
            for rows in ([s.emissivity for s in samples], [s.extinction for s in samples]):
                sums = (sum(own[1:], own[0]) for own in zip(*rows, strict=True))
                found += sums
        return found

    def split(self, values: list[Float], channel: int | None = None) -> JAlpha:
        """Return j and α per unit of the scale from the state of the gas, of one channel or all."""
        chosen = list(range(self.emissions)) if channel is None else [channel]
        zero, scale = values[0] * 0.0, self.context.kept_number(self.binding.length)
        j, alpha = [zero for _ in chosen], [zero for _ in chosen]
        for part, own in self._of_lines():
            sample = part.from_states(values[own], chosen, self.context)
            j = [dr.fma(scale, a, b) for a, b in zip(sample.emissivity, j, strict=True)]
            alpha = [dr.fma(scale, a, b) for a, b in zip(sample.extinction, alpha, strict=True)]
        if self.others:
            k = self.emissions
            first = len(values) - 2 * k
            j = [values[first + c] + v for c, v in zip(chosen, j, strict=True)]
            alpha = [values[first + k + c] + v for c, v in zip(chosen, alpha, strict=True)]
        # In units of channels, as tables of coefficients.
        units = [self.context.kept_number(1.0 / float(self.unit[c])) for c in chosen]
        return [u * v for u, v in zip(units, j, strict=True)], alpha

    def _of_lines(self) -> Iterator[tuple[Lines, slice]]:
        first = 0
        for part in self.lines:
            yield part, slice(first, first + part.state_count)
            first += part.state_count

    def steps(self, first: list[Float], last: list[Float], resolution: float) -> list[Float]:
        """Return, per channel, the number of steps that resolve lines between two states."""
        found = [first[0] * 0.0] * self.emissions
        for part, own in self._of_lines():
            counts = part.steps(first[own], last[own], resolution, self.context)
            found = [dr.select(a > b, a, b) for a, b in zip(counts, found, strict=True)]
        return found

    def largest(self, values: list[float]) -> list[float]:
        return [math.inf] * (self.emissions + self.extinctions)
