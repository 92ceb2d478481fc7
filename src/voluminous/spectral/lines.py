"""Spectral lines of molecules and atoms, with their Doppler shifts along each ray."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr, from_host
from ..backend.functions import any_attenuation, branch, decay
from ..backend.types import Float, Mask
from ..errors import InputError, unknown_name
from ..expressions.interval import Interval
from ..geometry import CARTESIAN, CYLINDRICAL, SPHERICAL
from ..media.bound import Binding
from ..media.context import Context, Feature, Halves, MediumSample
from ..media.gaussian import Gaussian, gaussian_mean
from ..media.panel import Panel, extremes, kept, third_differences
from ..media.quadrature import boole, midway, parabola, simpson
from .medium import Bands, BoundSpectral, InCgs, SpectralMedium, given_field, model_of

if TYPE_CHECKING:
    from ..physics.molecule import Molecule
    from ..volume import Volume

# Beyond so many Doppler widths a line is not there: exp(-144) = 3e-63.
_MARGIN = 12.0
# The narrowest line: 1 cm/s. Without turbulence gas of 0 K would have none at all.
_NARROWEST = 1.0
# What is fainter than this part of a line's centre need not be exact; a bound of profiles.
_LEAST = 1e-10
# Temperatures at which the partition function is tabulated; it is linear in between.
_NODES = 2048
# The line is smooth on a panel if the velocity changes from quarter to quarter by less than this
# many Doppler widths.
_SMOOTH = 0.8
# The error of Boole's rule on halves, as a part of its difference from that on the whole panel.
_TOLD_BY_BOOLE, _TOLD_BY_QUARTIC = 0.15, 0.01
# The error of the closed form, as a part of that of a cubic velocity: widths change, too.
_TOLD_IF_STEEP = 1.0
# The profile exp(-z²): its width is a Doppler width over √2.
_PROFILE = Gaussian("v", 0.0, 1.0, 1.0, 0.0, 1.0)
_ROOT2 = math.sqrt(2.0)


@dataclass(frozen=True)
class Transition:
    """One line, and what its emission and absorption are multiplied by."""

    up: int
    low: int
    frequency: float
    lower: float  # (E_l - E_1)/k in K
    step: float  # (E_u - E_l)/k in K
    emission: float
    absorption: float
    ratio: float  # g_u/g_l


@dataclass
class LineState:
    """Gas at a place: inverse Doppler width, velocity away from the observer, and each line.

    `bright` and `dense` are emission and absorption at the centres of lines, where the profile is
    exp(-z²).
    """

    narrowness: Float
    velocity: Float
    bright: list[Float]
    dense: list[Float]


class Lines(SpectralMedium):
    """Lines of one kind of molecule, broadened by heat and turbulence and shifted by motion.

    Parameters
    ----------
    density : str, Quantity or number; or Volume
        Number density of the molecule; cm⁻³ without a unit. A volume opened from a model of
        RADMC-3D has all that is needed.
    molecule : Molecule or str
        Its levels and lines; or its name in the model.
    temperature : str, Quantity or number
        Of the gas; K without a unit.
    velocity : str or three of these, optional
        A vector's name: ``"velocity"`` has the fields ``velocity_x`` …, or ``velocity_r`` …; or
        three components along x, y and z. cm/s without a unit. At rest by default.
    turbulence : str, Quantity or number, optional
        Width b of turbulent motions: lines have the Doppler width a² = b² + 2kT/m.
    populations : str or sequence, optional
        Number densities of the levels, as fields ``name_1``, ``name_2`` …, or one expression for
        each level. By default those of local thermodynamic equilibrium (LTE).

    Raises
    ------
    InputError
        If something is missing.

    Notes
    -----
    Einstein coefficients, and emission and absorption of a line: Rybicki & Lightman (1979),
    equations 1.72 to 1.79; populations in LTE: 9.3 and 9.5; Doppler profile: 10.68. Extinction is
    never negative: masers are not drawn. In single precision wings are zero from nine widths on,
    where they are 1e-35 of the line's centre.
    """

    kind = "lines"
    sight: tuple[str, ...] = ()

    def __init__(
        self,
        density: Any,
        molecule: Molecule | str,
        *,
        temperature: Any = None,
        velocity: Any = None,
        turbulence: Any = None,
        populations: Any = None,
    ) -> None:
        if isinstance(molecule, str) and not hasattr(density, "grid"):
            raise InputError(
                f"a molecule by name ({molecule!r}) needs a model of RADMC-3D that has it: "
                "vm.Lines(volume, name); or give vm.Molecule.open(path)"
            )
        if hasattr(density, "grid"):
            volume = density
            if isinstance(molecule, str):
                known = model_of(volume, f"vm.Lines(volume, {molecule!r})").molecules
                if molecule not in known:
                    raise unknown_name("molecule", molecule, known)
                density, molecule = f"numberdens_{molecule}", known[molecule]
            else:
                density = f"numberdens_{molecule.name}"
            if temperature is None:
                temperature = _in(volume, "gas_temperature")
            if velocity is None and _has_velocity(volume):
                velocity = "gas_velocity"
            if turbulence is None:
                turbulence = _in(volume, "microturbulence")
        if not hasattr(molecule, "einstein_a"):
            raise InputError(
                f"lines need a vm.Molecule, such as vm.Molecule.open('co.dat'), got {molecule!r}"
            )
        is_vector = isinstance(velocity, (list, tuple)) and len(velocity) == 3
        if not (velocity is None or isinstance(velocity, str) or is_vector):
            raise InputError(
                f"velocity must be a vector's name or three of x, y, z, got {velocity!r}"
            )
        if not (populations is None or isinstance(populations, (str, list, tuple))):
            raise InputError(
                "populations are the stem of fields' names, or an expression for each level, got "
                f"{populations!r}"
            )
        if temperature is None:
            raise InputError("lines need the temperature of the gas: temperature='T'")
        self.density = given_field(density, "density")
        self.molecule: Any = molecule
        self.temperature = given_field(temperature, "temperature")
        self.velocity = velocity
        self.turbulence = 0.0 if turbulence is None else given_field(turbulence, "turbulence")
        self.populations = populations
        self._fields: tuple[InCgs, ...] = ()
        self._moves: tuple[InCgs, ...] = ()
        self._levels: tuple[InCgs, ...] = ()
        self._lines: tuple[Transition, ...] = ()
        self._nodes: tuple[np.ndarray, np.ndarray] = (np.zeros(0), np.zeros(0))
        self._per_kelvin = 0.0
        self._shifts, self._ratio = np.zeros((0, 0)), np.zeros(0)
        self._even_nodes = True

    # --- numbers --------------------------------------------------------------------------------

    def temperatures(self, volume: Volume) -> list[InCgs]:
        return [InCgs.of(self.temperature, "K", "temperature", volume)]

    def quantities(self) -> Sequence[InCgs]:
        return (*self._fields, *self._moves, *self._levels)

    def features(self) -> tuple[Feature, ...]:
        # Velocities are resolved to a part of the width of a line.
        moves = tuple(Feature(q.expr, self._width / q.factor) for q in self._moves if q.expr.names)
        others = (q for q in (*self._fields, *self._levels) if q.expr.names)
        return (*map(Feature, (q.expr for q in others)), *moves)

    def heat(self) -> Sequence[InCgs]:
        return self._fields[1:2] if self.populations is None else ()

    def tuned(self, bands: Bands) -> SpectralMedium:
        medium = self if self.bands is not None else self._in_volume(bands)
        molecule, light = self.molecule, bands.constants.c
        nu, rest = bands.frequencies, np.asarray(molecule.frequencies)
        shifts = light * (nu[None, :] - rest[:, None]) / rest[:, None]
        active = np.flatnonzero((np.abs(shifts) < medium._farthest).any(axis=1))
        lines = tuple(self._transition(int(k), bands) for k in active)
        levels: Sequence[int] = ()
        if self.populations is not None:
            levels = sorted({level for line in lines for level in (line.up, line.low)})
        return medium.changed(
            bands=bands,
            channels=len(nu),
            _lines=lines,
            _levels=self._populations(levels, bands.volume),
            _level_numbers=levels,
            _shifts=shifts[active],
            _ratio=bands.unit[0] / bands.unit,
        )

    def _in_volume(self, bands: Bands) -> Lines:
        volume, constants, molecule = bands.volume, bands.constants, self.molecule
        density, temperature, turbulence = (
            InCgs.of(value, unit, what, volume)
            for value, unit, what in (
                (self.density, "1 / cm3", "density"),
                (self.temperature, "K", "temperature"),
                (self.turbulence, "cm / s", "turbulence"),
            )
        )
        moves, axes = self._components(volume)
        per_kelvin = 2.0 * constants.k / (molecule.weight * constants.proton_mass)
        (cold, hot), (calm, wild) = (q.extremes(bands) for q in (temperature, turbulence))
        cold, hot = max(cold, 0.1), max(hot, 0.1)
        widest, narrowest = (
            math.sqrt(per_kelvin * t + b * b) for t, b in ((hot, wild), (cold, calm))
        )
        ends = (max(map(abs, move.extremes(bands))) for move in moves)
        return self.changed(
            _fields=(density, temperature, turbulence),
            _moves=moves,
            sight=axes,
            _width=max(narrowest, _NARROWEST),
            _widest=widest,
            _per_kelvin=per_kelvin,
            _nodes=self._partition(cold, hot, constants),
            _even_nodes=molecule.partition is None,
            _farthest=_MARGIN * widest + math.sqrt(sum(v * v for v in ends)),
        )

    @property
    def is_seen(self) -> bool:
        """Whether a line is seen in any channel: less than four widths away, exp(-16)."""
        return bool((np.abs(self._shifts) < self._farthest - (_MARGIN - 4.0) * self._widest).any())

    _width = _widest = 1.0
    _farthest = 0.0
    _level_numbers: Sequence[int] = ()

    def constant_arrays(self) -> Sequence[np.ndarray]:
        rows = [
            (x.frequency, x.lower, x.step, x.emission, x.absorption, x.ratio) for x in self._lines
        ]
        return [np.array(rows, dtype=np.float64), np.array([self._per_kelvin]), *self._nodes]

    def _transition(self, k: int, bands: Bands) -> Transition:
        """Return a line, with h c A g_u/(4 π^1.5) and A c³ g_u/(8 π^1.5 ν³) in units of bands."""
        constants, molecule = bands.constants, self.molecule
        up, low = int(molecule.up[k]), int(molecule.low[k])
        nu, rate = float(molecule.frequencies[k]), float(molecule.einstein_a[k])
        weight = 1.0 if self.populations is not None else float(molecule.weights[up])
        lower, upper = (float(molecule.energies[i] - molecule.energies[0]) for i in (low, up))
        # With CODATA's constants of the line's own frequency: S = B_ν(T), to rounding.
        step = constants.planck_exponent * nu
        if constants.name == "radmc3d":
            step = constants.boltzmann * (upper - lower)
        common = rate * weight * bands.length / math.pi**1.5
        return Transition(
            up,
            low,
            nu,
            constants.boltzmann * lower,
            step,
            common * constants.h * constants.c / 4.0 / float(bands.unit[0]),
            common * constants.c**3 / (8.0 * nu**3),
            float(molecule.weights[up] / molecule.weights[low]),
        )

    def _populations(self, levels: Sequence[int], volume: Volume) -> tuple[InCgs, ...]:
        given = self.populations
        if given is None:
            return ()
        names = [f"{given}_{k + 1}" for k in levels] if isinstance(given, str) else None
        if names is None and max(levels, default=0) >= len(given):
            raise InputError(
                f"populations has {len(given)} levels, but the lines need {max(levels) + 1}"
            )
        chosen = names or [given[k] for k in levels]
        return tuple(InCgs.of(v, "1 / cm3", "population", volume) for v in chosen)

    def _components(self, volume: Volume) -> tuple[tuple[InCgs, ...], tuple[str, ...]]:
        given = self.velocity
        if given is None:
            return (), ()
        if not isinstance(given, str):
            return tuple(InCgs.of(v, "cm / s", "velocity", volume) for v in given), CARTESIAN
        for system in (volume.grid.coordinates, CARTESIAN, SPHERICAL, CYLINDRICAL):
            names = [f"{given}_{axis}" for axis in system]
            if all(name in volume.fields for name in names):
                parts = tuple(InCgs.of(name, "cm / s", "velocity", volume) for name in names)
                return parts, tuple(system)
        expected = ", ".join(f"{given}_{axis}" for axis in volume.grid.coordinates)
        raise InputError(f"there is no vector {given!r} in the volume: expected {expected}")

    def _partition(self, cold: float, hot: float, constants: Any) -> tuple[np.ndarray, np.ndarray]:
        if self.populations is not None:
            return np.ones(2), np.ones(2)
        molecule = self.molecule
        if molecule.partition is not None:
            return tuple(np.asarray(v, dtype=np.float64) for v in molecule.partition)  # type: ignore[return-value]
        if constants.name == "radmc3d":  # its own nodes
            nodes = 0.1 * 1e6 ** (np.arange(1000) / 999)
        else:
            nodes = np.geomspace(0.99 * cold, 1.01 * hot, _NODES)
        return nodes, np.asarray(molecule.partition_function(nodes, constants))

    def bound(self, binding: Binding) -> BoundSpectral:
        return BoundLines(self, binding)

    # --- at places ------------------------------------------------------------------------------

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        return self._in_channels(self._state(fields, context), range(self.channels), context)

    def _in_channels(
        self, state: LineState, channels: Sequence[int], context: Context
    ) -> MediumSample:
        """Return j and α per unit length of some channels."""
        zero, speed = state.velocity * 0.0, state.velocity * state.narrowness
        j, alpha = [zero for _ in channels], [zero for _ in channels]
        for k, (bright, dense) in enumerate(zip(state.bright, state.dense, strict=True)):
            shifts = self.row(context, f"v {k}", self._shifts[k])
            for n, c in enumerate(channels):
                z = dr.fma(shifts[c], state.narrowness, speed)
                shape = decay(z * z)
                j[n] = dr.fma(bright, shape, j[n])
                alpha[n] = dr.fma(dense, shape, alpha[n])
        ratio = self.row(context, "unit", self._ratio)
        return MediumSample([ratio[c] * v for c, v in zip(channels, j, strict=True)], alpha)

    def _state(self, fields: dict[str, Any], context: Context) -> LineState:
        density, turbulence = (self._fields[k].value(fields, context) for k in (0, 2))
        temperature = self._fields[1].where(density, fields, context)
        number = context.kept_number
        narrowness = self._narrowness(temperature, turbulence, context)
        velocity = self._velocity(fields, context) + narrowness * 0.0
        if self.populations is not None:
            return self._of_levels(
                velocity, narrowness, self._level_pairs(fields, context), context
            )
        bright, dense = [], []
        cold = 1.0 / temperature
        base = density * narrowness / self._partition_at(temperature, context)
        for line in self._lines:
            low = base * dr.exp(-number(line.lower) * cold)
            step = number(line.step) * cold
            theta, mean = any_attenuation(step)
            bright.append(low * theta * number(line.emission))
            dense.append(low * (step * mean) * number(line.absorption))
        return LineState(narrowness, velocity, bright, dense)

    def _level_pairs(self, fields: dict[str, Any], context: Context) -> list[tuple[Any, Any]]:
        """Return the given populations of each line: of the upper level, and g_u/g_l × lower."""
        levels = [q.value(fields, context) for q in self._levels]
        own = dict(zip(self._level_numbers, levels, strict=True))
        number = context.kept_number
        return [(own[line.up], own[line.low] * number(line.ratio)) for line in self._lines]

    def _of_levels(
        self,
        velocity: Float,
        narrowness: Float,
        levels: list[tuple[Any, Any]],
        context: Context,
    ) -> LineState:
        """Return the gas with populations of the levels of each line, as of `_level_pairs`."""
        number, bright, dense = context.kept_number, [], []
        for line, (up, low) in zip(self._lines, levels, strict=True):
            bright.append(up * narrowness * number(line.emission))
            absorbed = (low - up) * narrowness * number(line.absorption)
            dense.append(dr.select(absorbed > 0.0, absorbed, 0.0))
        return LineState(narrowness, velocity, bright, dense)

    # --- states, which RADMC-3D interpolates ----------------------------------------------------

    @property
    def state_count(self) -> int:
        """Number of values of `states`."""
        return 3 + 2 * len(self._lines)

    def states(self, fields: dict[str, Any], context: Context) -> list[Float]:
        """Return velocity away from the observer, turbulence, temperature, and populations.

        Of each line those of the upper and the lower level, over their statistical weights.
        """
        density, turbulence = (self._fields[k].value(fields, context) for k in (0, 2))
        temperature = self._fields[1].where(density, fields, context)
        velocity = self._velocity(fields, context) + 0.0 * temperature
        found = [velocity, turbulence + 0.0 * temperature, temperature]
        if self.populations is not None:
            return found + [v for pair in self._level_pairs(fields, context) for v in pair]
        base = density / self._partition_at(temperature, context)
        for line in self._lines:
            low = base * dr.exp(-context.kept_number(line.lower) / temperature)
            found += [low * dr.exp(-context.kept_number(line.step) / temperature), low]
        return found

    def from_states(
        self, values: list[Float], channels: Sequence[int], context: Context
    ) -> MediumSample:
        """Return j and α per unit length of some channels from (interpolated) states."""
        velocity, turbulence, temperature, *levels = values
        narrowness = self._narrowness(temperature, turbulence, context)
        pairs = list(zip(levels[::2], levels[1::2], strict=True))
        state = self._of_levels(velocity, narrowness, pairs, context)
        return self._in_channels(state, channels, context)

    def steps(
        self, first: list[Float], last: list[Float], resolution: float, context: Context
    ) -> list[Float]:
        """Return, per channel, the number of steps in which a line shifts by part of its width.

        RADMC-3D's rule: the width is the sum of the smaller turbulent and the smaller thermal one;
        lines more than twelve widths away do not count.
        """
        assert self.bands is not None
        light = self.bands.constants.c
        calm, cold = (dr.minimum(a, b) for a, b in zip(first[1:3], last[1:3], strict=True))
        width = (calm + dr.sqrt(context.kept_number(self._per_kelvin) * cold)) / light
        found = [width * 0.0] * self.channels
        frequencies = self.row(context, "ν", self.bands.frequencies)
        for line in self._lines:
            rest = context.kept_number(line.frequency)
            one, other = (rest - rest * (v[0] / light) for v in (first, last))
            low, high = dr.minimum(one, other), dr.maximum(one, other)
            for c, nu in enumerate(frequencies):
                least = resolution * width * nu
                near = (high > nu - _MARGIN * width * nu) & (low < nu + _MARGIN * width * nu)
                count = dr.floor((high - low) / dr.select(least > 0.0, least, 1.0) + 1.0)
                count = dr.select(near & (high - low > least), count, 0.0)
                found[c] = dr.select(count > found[c], count, found[c])
        return found

    def _velocity(self, fields: dict[str, Any], context: Context) -> Any:
        found: Any = 0.0
        for move, axis in zip(self._moves, self.sight, strict=True):
            found = found + move.value(fields, context) * fields[f"los.{axis}"]
        return found

    def _narrowness(self, temperature: Float, turbulence: Float, context: Context) -> Float:
        square = context.kept_number(self._per_kelvin) * temperature + turbulence * turbulence
        return 1.0 / dr.sqrt(dr.select(square > _NARROWEST**2, square, _NARROWEST**2))

    def _partition_at(self, temperature: Float, context: Context) -> Float:
        nodes, values = self._nodes
        if not self._even_nodes:
            return context.interpolate(temperature, nodes, [values])[0]
        # Nodes in equal ratios are found by a logarithm: a bisection would take as long as a line.
        real = context.real
        places, table = context.keep(
            (id(self), "Z"), lambda: tuple(from_host(real, v) for v in (nodes, values))
        )
        step = math.log(nodes[-1] / nodes[0]) / (len(nodes) - 1)
        first, per_step = context.kept_number(math.log(nodes[0])), context.kept_number(1.0 / step)
        UInt = dr.uint32_array_t(real)
        last = context.kept_number(len(nodes) - 2.0)
        place = (dr.log(temperature) - first) * per_step
        place = dr.select(place > 0.0, dr.select(place < last, place, last), 0.0)
        k = UInt(place)
        low, high = (dr.gather(real, places, k + n) for n in (0, 1))
        before, after = (dr.gather(real, table, k + n) for n in (0, 1))
        part = (temperature - low) / (high - low)
        part = dr.select(part > 0.0, part, 0.0)
        return dr.fma(part, after - before, before)

    # --- ranges ---------------------------------------------------------------------------------

    def ranges(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        density, warm, turbulence = (q.value(fields, context) for q in self._fields)
        cold, hot = (np.maximum(t, 1e-99) for t in (warm.lo, warm.hi))
        narrow, wide = self._widths(fields, context)
        speed = self._speed(fields, context)
        least = [np.zeros(np.shape(narrow)) for _ in range(2 * self.channels)]
        most = [np.zeros(np.shape(narrow)) for _ in range(2 * self.channels)]
        levels = [q.value(fields, context) for q in self._levels]
        own = dict(zip(self._level_numbers, levels, strict=True))
        for k, line in enumerate(self._lines):
            if self.populations is not None:
                up, low = own[line.up].hi, own[line.low].hi * line.ratio
                ends = [(0.0, up * line.emission), (0.0, low * line.absorption)]
                ends = [(a / wide, b / narrow) for a, b in ends]
            else:
                nodes, table = self._nodes
                z = [np.interp(t, nodes, table) for t in (cold, hot)]
                base = (
                    density.lo * np.exp(-line.lower / cold) / (z[1] * wide),
                    density.hi * np.exp(-line.lower / hot) / (z[0] * narrow),
                )
                theta = [np.exp(-line.step / t) for t in (cold, hot)]
                lost = [-np.expm1(-line.step / t) for t in (hot, cold)]
                ends = [
                    (base[0] * a * factor, base[1] * b * factor)
                    for (a, b), factor in ((theta, line.emission), (lost, line.absorption))
                ]
            for c, shift in enumerate(np.abs(self._shifts[k])):
                near = np.maximum(shift - speed, 0.0) / wide
                shape = np.exp(-(((shift + speed) / narrow) ** 2)), np.exp(-(near**2))
                shape = shape[0], np.maximum(shape[1], _LEAST)
                for place, (a, b), r in (
                    (c, ends[0], self._ratio[c]),
                    (self.channels + c, ends[1], 1.0),
                ):
                    least[place] = least[place] + r * a * shape[0]
                    most[place] = most[place] + r * b * shape[1]
        missing = density.nan | warm.nan | turbulence.nan
        found = [Interval(a, b, missing) for a, b in zip(least, most, strict=True)]
        return MediumSample(found[: self.channels], found[self.channels :])

    def _widths(self, fields: dict[str, Interval], context: Context) -> tuple[Any, Any]:
        _, warm, turbulence = (q.value(fields, context) for q in self._fields)
        square = self._per_kelvin * warm + turbulence * turbulence
        low, high = (np.sqrt(np.maximum(end, _NARROWEST**2)) for end in (square.lo, square.hi))
        return low, high

    def _speed(self, fields: dict[str, Interval], context: Context) -> Any:
        parts = [q.value(fields, context).size for q in self._moves]
        return np.sqrt(sum((v * v for v in parts), np.float64(0.0)))


class BoundLines(BoundSpectral):
    """The numbers of `Lines` in a kernel's units."""

    medium: Lines

    def may_show(self, ranges: dict[str, Interval], context: Context) -> Mask:
        lines = self.medium
        density, _, _ = (q.value(ranges, context) for q in lines._fields)
        _, wide = lines._widths(ranges, context)
        near = lines._speed(ranges, context) + _reach(context) * wide
        seen = np.zeros(np.shape(near), bool)
        if lines._shifts.size:
            for shift in np.unique(np.abs(lines._shifts)):
                seen = seen | ~(shift > near)
        there = density.nan | (density.size > 0.0) | (lines.populations is not None)
        return np.asarray(seen & there)

    def visible(self, panel: Panel) -> tuple[Mask, Mask]:
        context = panel.context
        if not any(panel.places):  # without error control panels are looked at without their fields
            return super().visible(panel)
        states = self._along(panel)
        narrow = [state.narrowness for state in states]
        speed = [state.velocity * n for state, n in zip(states, narrow, strict=True)]
        low, high = extremes(speed)
        sharp = extremes(narrow)
        more = 0.25 * (high - low)
        seen, reach = panel.length < 0.0, context.narrow_number(_reach(context))
        for shifts in self.medium._shifts:
            ends = [context.narrow_number(float(end)) for end in (shifts.min(), shifts.max())]
            first, last = (
                end * dr.select((end > 0.0) == up, sharp[1], sharp[0])
                for up, end in zip((False, True), ends, strict=True)
            )
            seen |= (first + low - more < reach) & (last + high + more > -reach)
        unknown = dr.isnan(low + high)
        return seen | unknown, panel.length < 0.0

    def _along(self, panel: Panel) -> list[LineState]:
        """Return the gas at the places of a panel, in the type of integrals; computed once."""
        context = panel.context

        def state(s: float) -> LineState:
            found = self.medium._state(panel.fields(s), context)
            narrow = context.narrow
            return LineState(
                narrow(found.narrowness),
                narrow(found.velocity),
                [narrow(v) for v in found.bright],
                [narrow(v) for v in found.dense],
            )

        def states() -> list[LineState]:
            return [state(s) for s in panel.where]

        return kept(panel, (id(self), "states"), states)

    def mean(self, panel: Panel) -> MediumSample:
        context = panel.context
        first, middle, last = self._along(panel)
        found = _Sums(self, context)
        ends = [(s.narrowness, s.velocity * s.narrowness) for s in (first, last)]
        for k in range(len(self.medium._lines)):
            rows = ([getattr(s, name)[k] for s in (first, middle, last)] for name in _NAMES)
            bright, dense = (simpson(*row) for row in rows)
            for c, shift in enumerate(found.shifts[k]):
                z = [_ROOT2 * dr.fma(shift, n, u) for n, u in ends]
                shape = gaussian_mean(z[0], z[1], context.faint)
                found.add(c, [shape * bright], [shape * dense])
        return found.samples()[0]

    def halves(self, panel: Panel) -> Halves:
        """Return means of the lines' profiles times what they are multiplied by.

        Where the velocity changes by less than the line's width Boole's rule does it; elsewhere the
        profile is integrated in closed form, and its factor taken at its centre of mass.
        """
        context = panel.context
        states, found = self._along(panel), _Sums(self, context)
        narrow = [s.narrowness for s in states]
        speed = [s.velocity * n for s, n in zip(states, narrow, strict=True)]
        change = extremes([dr.abs(b - a) for a, b in pairwise(speed)])[1]
        for k in range(len(self.medium._lines)):
            bright, dense = ([getattr(s, name)[k] for s in states] for name in _NAMES)
            shifts = found.shifts[k]
            widest = context.narrow_number(float(np.abs(self.medium._shifts[k]).max()))
            change = change + widest * extremes([dr.abs(b - a) for a, b in pairwise(narrow)])[1]

            def smooth(rows: list[list[Float]], shifts: list[Float] = shifts) -> list[Float]:
                narrow, speed, bright, dense = rows
                return _by_boole(narrow, speed, bright, dense, shifts)

            def steep(rows: list[list[Float]], shifts: list[Float] = shifts) -> list[Float]:
                narrow, speed, bright, dense = rows
                return _in_closed_form(narrow, speed, bright, dense, shifts, context.faint)

            rows = [narrow, speed, bright, dense]
            values = branch((rows,), change < _SMOOTH, smooth, steep)
            for c in range(self.medium.channels):
                found.add(c, values[6 * c : 6 * c + 3], values[6 * c + 3 : 6 * c + 6])
        return Halves(*found.samples())


_NAMES = ("bright", "dense")


def _by_boole(
    narrow: list[Float],
    speed: list[Float],
    bright: list[Float],
    dense: list[Float],
    shifts: list[Float],
) -> list[Float]:
    rows = [midway(row) for row in (narrow, speed, bright, dense)]
    found = []
    bends = [_bend(row) for row in (speed, bright, dense)]
    for shift in shifts:
        shape = []
        for n, u in zip(*rows[:2], strict=True):
            z = dr.fma(shift, n, u)
            shape.append(decay(z * z))
        for row, bend in zip(rows[2:], bends[1:], strict=True):
            values = [a * b for a, b in zip(row, shape, strict=True)]
            first, last = boole(values[:5]), boole(values[4:])
            mean, whole = 0.5 * (first + last), boole(values[::2])
            error = _TOLD_BY_BOOLE * dr.abs(mean - whole)
            error = dr.fma(_TOLD_BY_QUARTIC * bends[0], dr.abs(mean), error)
            found += [first, last, dr.fma(_TOLD_BY_QUARTIC * bend, shape[4], error)]
    return found


def _bend(values: list[Float]) -> Float:
    a, b, c, d, e = values
    return dr.abs(a + e - 4.0 * (b + d) + 6.0 * c)


def _in_closed_form(
    narrow: list[Float],
    speed: list[Float],
    bright: list[Float],
    dense: list[Float],
    shifts: list[Float],
    faint: float,
) -> list[Float]:
    found = []
    for shift in shifts:
        nodes = [_ROOT2 * dr.fma(shift, n, u) for n, u in zip(narrow, speed, strict=True)]
        *shapes, error = _PROFILE.by_centers(nodes, faint)
        middles = [middle for _, middle in _PROFILE.centers(nodes, faint)]
        for row in (bright, dense):
            cubics, (least, most) = third_differences(row), extremes(row)
            parts, wrong = [], _TOLD_IF_STEEP * (dr.abs(row[0]) + dr.abs(row[4])) * error
            for own, cubic, shape, middle in zip(
                (row[:3], row[2:]), cubics, shapes, middles, strict=True
            ):
                value, off = parabola(own, cubic, middle.place, middle.spread)
                # What is too faint has no centre of mass.
                known = (off < most - least) & dr.isfinite(value)
                value, off = dr.select(known, value, own[1]), dr.select(known, off, most - least)
                parts.append(shape * value)
                wrong = dr.fma(0.5 * shape, off, wrong)
            found += [*parts, wrong]
    return found


def _reach(context: Context) -> float:
    return math.sqrt(-math.log(min(max(context.faint, 1e-60), 1e-6)))


class _Sums:
    """Sums over lines, per channel, of values over the first half, the last half, and errors."""

    def __init__(self, bound: BoundLines, context: Context) -> None:
        self.bound, self.context, lines = bound, context, bound.medium
        narrow = context.narrow_number
        self.shifts = context.keep(
            (bound._part, "shifts"),
            lambda: [[narrow(float(v)) for v in row] for row in lines._shifts],
        )
        self.bright: list[list[Float]] = [[] for _ in range(lines.channels)]
        self.dense: list[list[Float]] = [[] for _ in range(lines.channels)]

    def add(self, c: int, bright: list[Float], dense: list[Float]) -> None:
        for sums, new in ((self.bright, bright), (self.dense, dense)):
            sums[c] = [a + b for a, b in zip(sums[c], new, strict=True)] if sums[c] else list(new)

    def samples(self) -> list[MediumSample]:
        """Return the sums in the units of means."""
        context, bound = self.context, self.bound
        zero = context.narrow_number(0.0)
        count = max((len(row) for row in self.bright), default=0) or 3
        ratios = zip(bound.medium._ratio, bound.factors, strict=True)
        units, dense = context.keep(
            (bound._part, "units"),
            lambda: (
                [context.narrow_number(float(ratio * factor)) for ratio, factor in ratios],
                context.narrow_number(bound.binding.length),
            ),
        )
        samples = []
        for n in range(count):
            j = [u * (row[n] if row else zero) for u, row in zip(units, self.bright, strict=True)]
            alpha = [dense * (row[n] if row else zero) for row in self.dense]
            samples.append(MediumSample(j, alpha))
        return samples


def _in(volume: Volume, name: str) -> str | None:
    return name if name in volume.fields else None


def _has_velocity(volume: Volume) -> bool:
    return all(f"gas_velocity_{axis}" in volume.fields for axis in volume.grid.coordinates)
