"""Free–free emission and absorption (bremsstrahlung) of ionised gas."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.functions import any_attenuation
from ..errors import InputError, check_name
from ..expressions import Expression
from ..expressions.interval import Interval
from ..media.context import Context, MediumSample
from ..media.contract import Medium
from ..units import plain
from .medium import Bands, InCgs, Planck, SpectralMedium, given_field

if TYPE_CHECKING:
    from ..volume import Volume

_GAUNT = ("draine", "radmc3d")
# Draine (2011, equations 10.1 and 10.8), in cgs.
_EMISSION = 5.444e-41
_GAUNT_CONSTANT = 5.960


class FreeFree(SpectralMedium):
    """Ionised gas: α_ν from densities of electrons and ions, j_ν = α_ν B_ν(T).

    Parameters
    ----------
    electrons : str, Quantity or number, or Volume
        Number density of electrons; cm⁻³ without a unit. A volume opened from a model of RADMC-3D
        has all that is needed.
    ions : str, Quantity or number, optional
        That of ions; as many as electrons by default.
    temperature : str, Quantity or number
        Of the gas; K without a unit.
    charge : float
        Of the ions.
    gaunt : {"draine", "radmc3d"}, optional
        The Gaunt factor: Draine's, or α = 0.2120 n_e n_i ν^-2.1 T^-1.35 as in RADMC-3D, a power law
        for radio frequencies. Default: Draine's, or RADMC-3D's with its constants.

    Raises
    ------
    InputError
        If a temperature is missing.

    Notes
    -----
    B. T. Draine, *Physics of the interstellar and intergalactic medium* (2011): emissivity equation
    10.1, Gaunt factor 10.8 (within 10 % for 0.14 < Z ν₉/T₄^1.5 < 250).

    Between cells the product n_e n_i T^-1/2 is interpolated, not its factors, so that a thin medium
    emits as much as its cells; and the mean temperature has this product as its weight. Expressions
    of coordinates alone are evaluated where the ray is.
    """

    kind = "free-free"
    _interpolated = False

    def __init__(
        self,
        electrons: Any,
        ions: Any = None,
        temperature: Any = None,
        *,
        charge: float = 1.0,
        gaunt: str | None = None,
    ) -> None:
        if hasattr(electrons, "grid"):
            names = {"electron_numdens": None, "ion_numdens": ions, "gas_temperature": temperature}
            lacking = [n for n, v in names.items() if v is None and n not in electrons.fields]
            if lacking:
                raise InputError(f"the volume has no {', '.join(lacking)}, for free-free emission")
            electrons, ions, temperature = (n if v is None else v for n, v in names.items())
        if temperature is None:
            raise InputError("free-free emission needs the temperature of the gas: temperature='T'")
        if gaunt is not None:
            check_name("Gaunt factor", gaunt, _GAUNT)
        self.electrons = given_field(electrons, "electrons")
        self.ions = self.electrons if ions is None else given_field(ions, "ions")
        self.temperature = given_field(temperature, "temperature")
        self.charge, self.gaunt = plain(charge, None, "charge"), gaunt
        if not (isinstance(self.charge, float) and 0.0 < self.charge < math.inf):
            raise InputError(f"the charge of ions must be a positive number, got {charge!r}")
        self._fields: tuple[InCgs, ...] = ()
        self._planck: Planck | None = None
        self._absorbs = self._exponent = self._gaunt = np.zeros(0)
        self._is_radmc3d = False

    def temperatures(self, volume: Volume) -> list[InCgs]:
        return [InCgs.of(self.temperature, "K", "temperature", volume)]

    def quantities(self) -> Sequence[InCgs]:
        return self._fields

    def heat(self) -> Sequence[InCgs]:
        return self._fields[-1:]

    def on_rays(self) -> Medium:
        """Return the medium with its product as one field, for schemes that interpolate."""
        if self._interpolated or self.bands is None:
            return self
        volume, own, bands = self.bands.volume, self._fields, self.bands
        if not any(volume.given(q.expr.names) for q in own[:2]):
            return self
        given = (self.electrons, self.ions, self.temperature)
        electrons, ions, warm = (f"({Expression(value).text})" for value in given)
        # What has no unit is in CGS units already.
        known = [volume.expression_unit(Expression(e)) is not None for e in (electrons, ions, warm)]
        warm = f"({warm} / (1 K))" if known[2] else warm
        pairs, unit = f"{electrons} * {ions}", ("", "1 / cm3", "1 / cm6")[known[0] + known[1]]
        weights = [
            f"cellwise(where({pairs} > 0 and {warm} > 0, {pairs} * {warm} ** {power}, 0))"
            for power in (-0.5, 0.5)
        ]
        product = InCgs.of(weights[0], unit, "n_e n_i", volume)
        temperature = own[2]
        if temperature.expr.names:
            low, high = temperature.extremes(bands)
            mean = f"clip({weights[1]} / {weights[0]}, {low!r}, {high!r})"
            temperature = InCgs.of(mean, "", "temperature", volume)
        medium = self.changed(_fields=(product, temperature), _interpolated=True)
        return medium.at_frequencies(bands)

    def tuned(self, bands: Bands) -> SpectralMedium:
        volume, constants, nu = bands.volume, bands.constants, bands.frequencies
        is_radmc3d = (self.gaunt or constants.name) == "radmc3d"
        fields = self._fields
        if not self._interpolated:
            per_cm3 = [(self.electrons, "electrons"), (self.ions, "ions")]
            densities = (InCgs.of(value, "1 / cm3", what, volume) for value, what in per_cm3)
            fields = (*densities, *self.temperatures(volume))
        with np.errstate(over="ignore"):
            absorbs: Any = 0.2120 * nu**-2.1 * bands.length
        if not is_radmc3d:
            absorbs = _EMISSION * self.charge**2 * 100.0 * bands.length
            absorbs = absorbs / (constants.planck_factor * nu**3)
        return (
            super()
            .tuned(bands)
            .changed(
                _fields=fields,
                _planck=Planck(bands),
                _absorbs=np.asarray(absorbs),
                _exponent=constants.planck_exponent * nu,
                _gaunt=_GAUNT_CONSTANT - math.sqrt(3.0) / math.pi * np.log(self.charge * nu * 1e-3),
                _is_radmc3d=is_radmc3d,
            )
        )

    def constant_arrays(self) -> Sequence[np.ndarray]:
        return [self._absorbs, self._gaunt]

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        shared = math.prod(q.value(fields, context) for q in self._fields[:-1])
        temperature = self._fields[-1].where(shared, fields, context)
        assert self._planck is not None
        bright = self._planck.values(self, temperature, context)
        log = dr.log(temperature)
        absorbs = self.row(context, "α", self._absorbs)
        if self._is_radmc3d:
            shared = shared * dr.exp((-0.85 if self._interpolated else -1.35) * log)
            alpha = [a * shared for a in absorbs]
        else:
            slope = 1.5 * math.sqrt(3.0) / math.pi
            if not self._interpolated:
                shared = shared * dr.exp(-0.5 * log)
            alpha = []
            rows = (self.row(context, n, v) for n, v in (("x", self._exponent), ("g", self._gaunt)))
            for a, x, g in zip(absorbs, *rows, strict=True):
                gaunt = dr.log(dr.exp(dr.fma(slope, log, g)) + math.e)
                depth = x / temperature
                alpha.append(a * shared * gaunt * (depth * any_attenuation(depth)[1]))
        return MediumSample([a * b for a, b in zip(alpha, bright, strict=True)], alpha)

    def ranges(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        *numbers, warm = (q.value(fields, context) for q in self._fields)
        assert self._planck is not None
        pairs = math.prod(numbers)
        warm = Interval(warm.lo, warm.hi)  # undefined where there are no pairs
        if self._interpolated:
            pairs = pairs * Interval(*(np.sqrt(np.maximum(t, 0.0)) for t in (warm.lo, warm.hi)))
        low, high = (self._per_pair(t) for t in (warm.hi, warm.lo))  # it falls with temperature
        alpha = [pairs * Interval(a, b) for a, b in zip(low, high, strict=True)]
        between = self._planck.between(warm.lo, warm.hi)
        return MediumSample([a * b for a, b in zip(alpha, between, strict=True)], alpha)

    def _per_pair(self, temperature: np.ndarray) -> list[np.ndarray]:
        """Return the absorption by one electron and one ion per cm³ (NumPy)."""
        t = np.maximum(temperature, 1e-99)
        if self._is_radmc3d:
            return [a * t**-1.35 for a in self._absorbs]
        slope = 1.5 * math.sqrt(3.0) / math.pi
        rows = zip(self._absorbs, self._exponent, self._gaunt, strict=True)
        return [
            a / np.sqrt(t) * np.logaddexp(slope * np.log(t) + g, 1.0) * -np.expm1(-x / t)
            for a, x, g in rows
        ]
