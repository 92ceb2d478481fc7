"""Thermal emission and absorption of dust."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..expressions.interval import Interval
from ..media.context import Context, MediumSample
from .medium import Bands, InCgs, Planck, SpectralMedium, field_in, given_field, model_of

if TYPE_CHECKING:
    from ..physics.opacity import Opacity
    from ..volume import Volume


class Dust(SpectralMedium):
    """Dust of one or more species: α_ν = Σ ρ κ_ν, j_ν = Σ ρ κ_ν B_ν(T).

    Parameters
    ----------
    density : str, Quantity, number, or list of these; or Volume
        Mass of dust per volume, of each species: fields or expressions; g/cm³ without a unit. A
        volume opened from a model of RADMC-3D has all that is needed.
    temperature : str, Quantity, number, or list of these
        Of each species; K without a unit.
    opacity : Opacity or list of these
        Of each species, per mass of dust.
    scattering : {False, True, "none"}
        Light that is scattered into a ray is not computed. False: scattering does not dim either;
        True: it does. Both warn, when it is drawn, of an albedo that matters. ``"none"``: as False,
        and meant so; the default for a model of RADMC-3D with ``scattering_mode_max = 0``.

    Raises
    ------
    InputError
        If something is missing, the numbers of species differ, or scattered light is asked for.

    Notes
    -----
    Kirchhoff's law for matter in thermal equilibrium with itself (Rybicki & Lightman 1979,
    equation 1.37).

    Examples
    --------
    >>> import voluminous as vm
    >>> medium = vm.Dust("density / 100", 20.0, vm.Opacity.power_law(3.5, 870.0, 1.8))
    """

    kind = "dust"

    def __init__(
        self,
        density: Any,
        temperature: Any = None,
        opacity: Opacity | Sequence[Opacity] | None = None,
        *,
        scattering: bool | str = False,
    ) -> None:
        if not isinstance(scattering, (bool, np.bool_)) and repr(scattering) != "'none'":
            raise InputError(
                "light that is scattered is not computed yet: scattering is 'none', False, or True "
                f"if it dims, got {scattering!r}; RADMC-3D has more"
            )
        if hasattr(density, "grid"):
            if opacity is None and scattering is False and _is_without_scattering(density):
                scattering = "none"
            density, temperature, opacity = _of_model(density, temperature, opacity)
        if temperature is None or opacity is None:
            raise InputError(
                "dust needs a density, a temperature and an opacity: vm.Dust('dust_density', "
                "'dust_temperature', vm.Opacity.open('dustkappa_silicate.inp'))"
            )
        rows = [list(v) if isinstance(v, (list, tuple)) else [v] for v in (density, temperature)]
        self.opacity = tuple(opacity) if isinstance(opacity, (list, tuple)) else (opacity,)
        count = len(rows[0])
        rows[1] = rows[1] * count if len(rows[1]) == 1 else rows[1]
        if not count or len(rows[1]) != count or len(self.opacity) != count:
            raise InputError(
                f"there are {count} densities of dust, {len(rows[1])} temperatures and "
                f"{len(self.opacity)} opacities; give one of each for every species"
            )
        if wrong := [own for own in self.opacity if not hasattr(own, "absorption")]:
            raise InputError(
                "opacity must be a vm.Opacity, such as vm.Opacity.open(path), .power_law(…) or "
                f".published(name), got {wrong[0]!r}"
            )
        self.density = tuple(given_field(v, "density") for v in rows[0])
        self.temperature = tuple(given_field(v, "temperature") for v in rows[1])
        self.scattering = scattering if isinstance(scattering, str) else bool(scattering)
        self._fields: tuple[tuple[InCgs, InCgs], ...] = ()
        self._kappa = np.zeros((0, 2, 0))
        self._planck: Planck | None = None

    def temperatures(self, volume: Volume) -> list[InCgs]:
        return [InCgs.of(t, "K", "temperature", volume) for t in self.temperature]

    def quantities(self) -> Sequence[InCgs]:
        return [q for pair in self._fields for q in pair]

    def heat(self) -> Sequence[InCgs]:
        return [temperature for _, temperature in self._fields]

    def albedo(self) -> np.ndarray:
        """Return the albedo of the species with the highest per channel; 0 if meant to be none."""
        bands, known = self.bands, () if self.scattering == "none" else self.opacity
        assert bands is not None
        parts = [own.albedo(bands.frequencies, bands.constants) for own in known]
        return np.asarray(np.max([np.zeros(self.channels), *parts], axis=0))

    def tuned(self, bands: Bands) -> SpectralMedium:
        densities = (InCgs.of(d, "g / cm3", "density", bands.volume) for d in self.density)
        kappa = []
        for own in self.opacity:
            absorbed = own.absorption(bands.frequencies, bands.constants)
            lost = absorbed
            if self.scattering is True:
                lost = own.extinction(bands.frequencies, bands.constants)
            kappa.append([absorbed * bands.length, lost * bands.length])
        return (
            super()
            .tuned(bands)
            .changed(
                _fields=tuple(zip(densities, self.temperatures(bands.volume), strict=True)),
                _kappa=np.array(kappa),
                _planck=Planck(bands),
            )
        )

    def constant_arrays(self) -> Sequence[np.ndarray]:
        return [self._kappa]

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        planck, emission = self._planck, {}
        assert planck is not None
        j: list[Any] = [0.0] * self.channels
        alpha: list[Any] = [0.0] * self.channels
        for s, (density, temperature) in enumerate(self._fields):
            rho = density.value(fields, context)
            own = density.expr.text, temperature
            if own not in emission:
                warm = temperature.where(rho, fields, context)
                emission[own] = planck.values(self, warm, context)
            kappa = [self.row(context, f"κ {s} {n}", self._kappa[s, n]) for n in (0, 1)]
            for c, bright in enumerate(emission[own]):
                absorbed = rho * kappa[0][c]
                j[c] = j[c] + absorbed * bright
                alpha[c] = alpha[c] + (rho * kappa[1][c] if self.scattering is True else absorbed)
        return MediumSample(j, alpha)

    def ranges(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        planck = self._planck
        assert planck is not None
        j: list[Any] = [0.0] * self.channels
        alpha: list[Any] = [0.0] * self.channels
        for (density, temperature), kappa in zip(self._fields, self._kappa, strict=True):
            rho, warm = density.value(fields, context), temperature.value(fields, context)
            for c, bright in enumerate(planck.between(warm.lo, warm.hi)):
                j[c] = rho * kappa[0, c] * bright + j[c]
                alpha[c] = rho * kappa[1, c] + alpha[c]
        return MediumSample(j, alpha)


def _is_without_scattering(volume: Any) -> bool:
    """Return whether a volume is a model of RADMC-3D whose settings leave scattering out."""
    folder = getattr(volume, "meta", {}).get("radmc3d")
    settings = {} if folder is None else model_of(volume, "vm.Dust(volume)").settings
    mode = settings.get("scattering_mode_max", settings.get("scattering_mode", ""))
    return str(mode) in ("0", "0.0")


def _of_model(volume: Any, temperature: Any, opacity: Any) -> tuple[list[str], Any, Any]:
    """Return densities, temperatures and opacities of the dust in a model of RADMC-3D."""
    opacity = opacity or model_of(volume, "vm.Dust(volume)").opacities
    opacity = list(opacity) if isinstance(opacity, (list, tuple)) else [opacity]
    count = len(opacity)
    found = [
        [field_in(volume, stem, s, count) for s in range(count)]
        for stem in ("dust_density", "dust_temperature")
    ]
    if temperature is not None:
        found[1] = temperature
    elif missing := [name for name in found[1] if name not in volume.fields]:
        raise InputError(
            f"the model has no {', '.join(missing)}: write dust_temperature.dat, made by "
            "RADMC-3D's mctherm, or give temperature="
        )
    return found[0], found[1], opacity
