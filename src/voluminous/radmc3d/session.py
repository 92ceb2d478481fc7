"""What RADMC-3D's words make of a model: channels, media, camera and scheme, and the result."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..objects import Stars
from ..objects.contract import Layers, View
from .words import DEEP, LIGHT, PARSEC, Request, request_of

if TYPE_CHECKING:
    from ..image import Image
    from ..image.spectrum import Spectrum
    from ..media import Medium
    from ..progress import Progress
    from ..volume import Volume

# RADMC-3D's astronomical unit in apertures, and what it draws where a surface is not reached.
_APERTURE_AU, _NOT_REACHED = 1.49598e13, -1e91
# Pixels of less than this part of a star's radius are not divided at its edge.
_RESOLVED = 0.1
# With fewer pixels across an aperture is no circle. The first and the last frequency of a table of
# apertures are moved apart by this much.
_LEAST_APERTURE, _WIDENED = 10, (1.000001, 0.999999)
# Of a circular spectrum: azimuths, rings within the grid, and how far rays are off its walls.
_AZIMUTHS, _INNER, _OFF_WALLS = 128, 10, 1e-7
# Settings that change pictures and have no counterpart here, with the only value that is drawn.
_FIXED = {
    "camera_interpol_jnu": (1, "vertices have j and α, not S"),
    "sources_interpol_jnu": (1, "vertices have j and α, not S"),
    "camera_refine_criterion": (1, "sub-pixels are as wide as the cells"),
    "camera_spher_cavity_relres": (0.05, "sub-pixels follow RADMC-3D's defaults"),
    "camera_min_dangle": (0.05, "sub-pixels follow RADMC-3D's defaults"),
    "camera_max_dangle": (0.3, "sub-pixels follow RADMC-3D's defaults"),
    "camera_min_drr": (0.003, "sub-pixels follow RADMC-3D's defaults"),
    "camera_maxdphi": (0.1, "sub-steps follow RADMC-3D's default"),
    "alignment_mode": (0, "polarization needs Monte Carlo"),
    "lines_profile": (0, "lines have Gaussian profiles"),
    "incl_userdef_srcalp": (0, "a user's own module is not known; see vm.SpectralMedium"),
    "incl_quantum": (0, "grains that are heated by single photons need Monte Carlo"),
}
_BOUNDARIES = ("xl", "xr", "yl", "yr", "zl", "zr")
# Modes of level populations: LTE, stored or not; read from levelpop files.
_LTE, _GIVEN = (1, -1), 50


class Spheres(Stars):
    """Stars as spheres, as RADMC-3D draws those of ten pixels and more: pixels' centres decide."""

    def layers(self, view: View) -> Layers | None:
        layers = super().layers(view)
        pixel = max(view.frame.pixel)
        radii = np.asarray(view.length(self.radii, "radii"))
        if layers is None or not view.camera.parallel or pixel > _RESOLVED * radii.min():
            return layers
        x, y, _ = view.place(np.asarray(view.length(self.positions, "positions")))
        row, column = np.divmod(layers.pixel, view.frame.pixels[0])
        away = np.hypot(*(np.subtract.outer(a, b) for a, b in ((column, x), (row, y)))) * pixel
        inside = layers.some(np.flatnonzero((away < radii).any(axis=1)))
        whole = inside.opacity[:, None]
        return inside._replace(emission=inside.emission / whole, opacity=np.ones(len(whole)))


@dataclass(frozen=True)
class Session:
    """A request, and the model that it is about: words override what ``radmc3d.inp`` says.

    Attributes
    ----------
    frequencies : float64 array
        Of the channels, in Hz.
    """

    request: Request
    volume: Volume
    model: Any
    frequencies: np.ndarray

    @classmethod
    def of(cls, request: Request, folder: Path) -> Session:
        """Return the session of a model's folder.

        Raises
        ------
        InputError
            If the model needs what is not here (Monte Carlo, …), or lacks what the words name.
        """
        from ..io import open as open_volume
        from .model import read_model

        if not any(folder.glob("amr_grid.*")):
            raise InputError(
                f"{folder.resolve()} has no amr_grid.inp, so it is not the folder of a model; name "
                "one with --model DIR"
            )
        volume, model = open_volume(folder, format="radmc3d"), read_model(folder)
        session = cls(request, volume, model, np.zeros(0))
        session._refuse()
        return cls(request, volume, model, session._frequencies())

    def setting(self, name: str, default: float = 0.0) -> float:
        """Return a number in ``radmc3d.inp``."""
        text = str(self.model.settings.get(name, default)).lower().replace("d", "e")
        try:
            return float(text)
        except ValueError:
            raise InputError(f"radmc3d.inp: {name} must be a number, got {text!r}") from None

    def _refuse(self) -> None:
        for name, (value, why) in _FIXED.items():
            if self.setting(name, value) != value:
                raise InputError(f"radmc3d.inp: {name} must be {value:g}: {why}")
        mode = int(self.setting("lines_mode", 1))
        if self.lines and mode not in (*_LTE, _GIVEN):
            raise InputError(
                f"radmc3d.inp: lines_mode = {mode}: levels that are not in LTE are not computed; "
                f"1 and -1 are LTE, {_GIVEN} reads levelpop files"
            )
        if self.dust and self.scatters and self.quantity == "intensity":
            raise InputError(
                "the opacities scatter, which needs Monte Carlo: give noscat, or set "
                "scattering_mode_max = 0 in radmc3d.inp"
            )

    # --- what is on ---------------------------------------------------------------------------

    def _included(self, word: bool | None, name: str, there: bool) -> bool:
        if word is not None:
            return word
        return bool(self.setting(name, float(there)) == 1.0)

    def _has(self, name: str) -> bool:
        return bool((self.model.path / name).is_file())

    @property
    def dust(self) -> bool:
        """Whether there is dust."""
        return self._included(self.request.dust, "incl_dust", self._has("dustopac.inp"))

    @property
    def lines(self) -> bool:
        """Whether there are lines."""
        return self._included(self.request.lines, "incl_lines", self._has("lines.inp"))

    @property
    def freefree(self) -> bool:
        """Whether there is free-free emission."""
        return self._included(self.request.freefree, "incl_freefree", False)

    @property
    def scatters(self) -> bool:
        """Whether dust scatters light."""
        allowed = self.setting("scattering_mode_max", self.setting("scattering_mode", 9999.0))
        words = (self.request.scattering, self.request.scattered)
        if False in words or allowed == 0.0:
            return False
        return any(np.any(opacity.scattering(3e13)) for opacity in self.model.opacities)

    @property
    def quantity(self) -> str:
        """What is drawn: "intensity", "tau" or "column"."""
        mode = int(self.setting("camera_tracemode", 1))
        return self.request.quantity or {-1: "column", -2: "tau"}.get(mode, "intensity")

    @property
    def binary(self) -> bool:
        """Whether an image is written in binary."""
        if self.request.command == "spectrum":
            return False
        return self._included(self.request.binary, "writeimage_unformatted", False)

    @property
    def wavelengths(self) -> np.ndarray:
        """Wavelengths of the channels in micron."""
        return np.asarray(1e4 * LIGHT / self.frequencies)

    def write(self, result: Image | Spectrum, path: Path) -> None:
        """Write RADMC-3D's file of a picture or a spectrum."""
        from ..image import Image
        from ..image.formats import radmc3d

        if isinstance(result, Image):
            radmc3d.write(result, path, wavelengths=self.wavelengths)
        else:
            radmc3d.write_spectrum(path, self.wavelengths, result.flux)

    # --- channels -----------------------------------------------------------------------------

    def _frequencies(self) -> np.ndarray:
        request, model = self.request, self.model
        match request.channels:
            case "lambda":
                waves: Any = [request.wavelength or 1.0]  # a column needs none, its file one
            case "lambdarange":
                assert request.wavelength_range is not None
                first, last = request.wavelength_range
                count = request.nlam or 1
                part = np.arange(count) / max(count - 1, 1)
                waves = first * (last / first) ** part
            case "ilambda":
                waves = [self._global(request.ilambda)]
            case "iline":
                return self._around_line()
            case "loadlambda":
                waves = model.camera_wavelengths
            case "color":
                waves = [self._global(k) for k in self._colors()]
            case _:
                if request.channels == "sed" and self.lines:
                    raise InputError("an sed has no lines: add noline, or use spectrum allwl")
                waves = model.wavelengths
        return np.asarray(1e4 * LIGHT / np.asarray(waves, dtype=np.float64))

    def _global(self, number: int | None) -> float:
        waves = self.model.wavelengths
        if number is None or not 1 <= number <= len(waves):
            raise InputError(
                f"wavelength_micron.inp has {len(waves)} wavelengths, from 1; got number {number}"
            )
        return float(waves[number - 1])

    def _colors(self) -> list[int]:
        path = self.model.path / "color_inus.inp"
        if not path.is_file():
            raise InputError(f"color reads {path}, which is not there")
        try:
            _, count, *numbers = map(int, path.read_text().split())
        except ValueError:
            raise InputError(f"{path}: expected whole numbers: 1, their count, and each") from None
        if len(numbers) != count:
            raise InputError(f"{path}: expected {count} numbers, found {len(numbers)}")
        return numbers

    def _around_line(self) -> np.ndarray:
        request, molecules = self.request, list(self.model.molecules.values())
        which, line = request.imolspec or 1, request.iline or 1
        if which > len(molecules):
            raise InputError(f"lines.inp has {len(molecules)} molecules; got imolspec {which}")
        lines = np.asarray(molecules[which - 1].frequencies)
        if line > len(lines):
            raise InputError(
                f"{molecules[which - 1].name} has {len(lines)} lines, from 1; got iline {line}"
            )
        count = request.linenlam
        part = 2.0 * np.arange(count) / (count - 1) - 1.0 if count > 1 else np.zeros(1)
        velocity = request.vkms + part * request.widthkms
        return np.asarray(lines[line - 1] * (1.0 - velocity * 1e5 / LIGHT))

    # --- drawing ------------------------------------------------------------------------------

    def result(self, **options: Any) -> Image | Spectrum:
        """Return the picture or the spectrum; options are those of `render`."""
        request = self.request
        if request.command == "spectrum":
            return self._spectrum(**options)
        if request.command == "tausurf":
            return self._surface(**options)
        if self.quantity == "column":
            return self._column(**options)
        from ..observing import observe

        cube = observe(
            self.volume, self.medium(), self.camera(), **self.how(self._halvings()), **options
        )
        if self.quantity == "tau":
            return cube.replace(intensity=cube.optical_depth, intensity_unit="")
        return cube

    def how(self, antialias: str | None) -> dict[str, Any]:
        """Return the options of `observe` that do what RADMC-3D does."""
        behind: dict[str, Any] = {} if self.quantity == "intensity" else {"background": 0.0}
        if not behind and any(self._boundaries()):
            behind = {"background": self._behind(antialias)}
        return {
            "frequencies": self.frequencies,
            "constants": "radmc3d",
            "scheme": self.scheme(),
            "cutoff": 0.0,
            "objects": self.stars(),
            "antialias": antialias,
            "_quiet": True,  # it is as RADMC-3D draws it
            **behind,
        }

    def medium(self) -> Medium:
        """Return dust, lines and free-free emission, as far as they are on."""
        from ..spectral import Dust, FreeFree, Lines

        parts: list[Medium] = []
        if self.dust:
            parts.append(Dust(self.volume, scattering=self.scatters or "none"))
        gas: dict[str, Any] = {}
        if species := int(self.setting("tgas_eq_tdust")):
            several = len(self.model.opacities) > 1
            gas["temperature"] = f"dust_temperature_{species}" if several else "dust_temperature"
        if self.lines:
            for name in self.model.molecules:
                own = dict(gas)
                if int(self.setting("lines_mode", 1)) == _GIVEN:
                    own["populations"] = f"levelpop_{name}"
                parts.append(Lines(self.volume, name, **own))
        if self.freefree:
            parts.append(FreeFree(self.volume, **gas))
        if not parts:
            raise InputError(
                "nothing is on: the model has neither dustopac.inp nor lines.inp, or words and "
                "radmc3d.inp switch all off"
            )
        medium = parts[0]
        for part in parts[1:]:
            medium = medium + part
        return medium

    def scheme(self) -> Any:
        """Return the scheme: of first or second order, or Doppler catching."""
        from ..schemes.base import TowardsObserver
        from ..schemes.first_order import FirstOrder
        from .olson_kunasz import OlsonKunasz

        scheme: Any = FirstOrder()
        if self.request.second:
            resolution = None
            if self.request.catching and self.lines:
                resolution = self.setting("catch_doppler_resolution", 0.2)
                resolution = 1.0 / resolution if resolution > 1.0 else resolution
            scheme = OlsonKunasz(catch_doppler_resolution=resolution)
        return TowardsObserver(scheme)  # which tells where rays along edges of cells are

    def stars(self) -> list[Any]:
        """Return the stars: points, or spheres with ``istar_sphere = 1``."""
        from ..observing.light import model_stars

        shown = self._included(self.request.stars, "camera_incl_stars", True)
        if not shown or self.quantity != "intensity" or not self.model.stars:
            return []
        if self.setting("istar_sphere") == 1.0:
            return [self._spheres()]
        return model_stars(self.volume)

    def _spheres(self) -> Stars:
        stars = self.model.stars
        return Spheres(
            [star.position for star in stars],
            [star.spectrum for star in stars],
            radii=[star.radius for star in stars],
        )

    def _boundaries(self) -> list[float]:
        """Return the temperatures of the grid's faces, along x, y and z; 0 for none."""
        return [self.setting(f"thermal_boundary_{face}") for face in _BOUNDARIES]

    def _behind(self, antialias: str | None) -> np.ndarray:
        """Return what is behind the grid: faces that shine, or else the external field.

        A face lights the rays that enter the grid through it, on their way to the observer.
        """
        from ..measuring.columns import lines_of_sight
        from ..observing.light import model_background
        from ..physics.constants import RADMC3D

        grid, camera = self.volume.grid, self.camera()
        if "theta" in grid.coordinates:
            raise InputError("radmc3d.inp: thermal boundaries are for Cartesian grids only")
        if antialias is not None:
            raise InputError("thermal boundaries are drawn with one ray per pixel: give nofluxcons")
        outside = model_background(self.volume)
        field = outside.intensity(self.frequencies, RADMC3D) if outside else 0.0
        origin, away = (part[..., None] for part in lines_of_sight(camera, grid))
        with np.errstate(divide="ignore", invalid="ignore"):
            reached = (grid.bounds - origin) / away  # of the low and the high face of each axis
        far = reached.max(axis=-1)
        axis = far.argmin(axis=-1)
        # An observer at infinity also sees what lies before the plane that distances count from.
        least = 0.0 if self.request.local else -np.inf
        seen = far.min(axis=-1) > np.maximum(reached.min(axis=-1).max(axis=-1), least)
        upper = np.take_along_axis(away[..., 0], axis[..., None], axis=-1)[..., 0] > 0.0
        warm = np.where(seen, np.array(self._boundaries())[2 * axis + upper], 0.0)[..., None]
        return np.where(warm > 0.0, RADMC3D.planck(self.frequencies, warm), field)

    def _halvings(self) -> str | None:
        asked = self.request.refine
        if self.request.local and (asked is None or asked < 1):
            return None  # RADMC-3D refuses unless nofluxcons is given
        depth = int(self.setting("camera_nrrefine", 100)) if asked is None else asked
        if 0 < depth < DEEP:
            raise InputError(
                f"pixels are halved as often as cells need it (fluxcons) or never (nofluxcons); "
                f"got nrrefine {depth}"
            )
        return "radmc3d" if depth > 0 else None

    def half_size(self) -> tuple[float, float]:
        """Return half the width and height of a picture, by default as in RADMC-3D."""
        if self.request.half_size is not None:
            return self.request.half_size
        grid = self.volume.grid
        if "theta" in grid.coordinates:
            side = float(np.float32(1.1)) * float(grid.edges[0][-1])
        else:  # in single precision in RADMC-3D
            factor = np.float32(1.01) * np.sqrt(np.float32(3.0)) * np.float32(0.5)
            side = float(factor) * float(np.max(grid.bounds[:, 1] - grid.bounds[:, 0]))
        return side, side

    def camera(self, half: tuple[float, float] | None = None) -> Any:
        """Return the camera."""
        from ..cameras import Orthographic, Perspective

        request, pixels = self.request, (self.request.nx, self.request.ny)
        width = tuple(2.0 * side for side in half or self.half_size())
        if not request.local:
            return Orthographic(
                request.incl,
                request.phi,
                request.posang,
                width=np.array(width) * self.volume.grid.unit,
                resolution=pixels,
                center=request.point,
                shift=request.middle,
            )
        if any(request.middle):
            raise InputError(
                "zoomradian is drawn around its middle only; give pointau and sizeradian"
            )
        flat = (request.projection or self.setting("camera_localobs_projection", 1)) == 1
        zenith = request.zenith
        return Perspective(
            request.observer,
            request.point,
            width=width,
            posang=request.posang,
            resolution=pixels,
            projection="flat" if flat else "spherical",
            zenith=self.setting("camera_localobs_zenith") if zenith is None else zenith,
        )

    def _surface(self, **options: Any) -> Image:
        from ..measuring import tau_surface
        from ..observing.cubes import tuned

        surface = tau_surface(
            self.volume,
            tuned(self.volume, self.medium(), frequencies=self.frequencies, constants="radmc3d"),
            self.camera(),
            self.request.depth,
            scheme=self.scheme(),
            **options,
        )
        towards = surface.depth.intensity * (1.0 if self.request.local else -1.0)
        return surface.depth.replace(intensity=np.where(np.isnan(towards), _NOT_REACHED, towards))

    def _column(self, **options: Any) -> Image:
        """Return the column density of dust in g/cm², the same at all wavelengths."""
        from ..measuring import column

        names = [name for name in self.volume.fields if name.startswith("dust_density")]
        found = column(self.volume, " + ".join(names), self.camera(), unit="g / cm2", **options)
        return found.replace(intensity=np.repeat(found.intensity, len(self.frequencies), axis=-1))

    # --- spectra ------------------------------------------------------------------------------

    def _spectrum(self, **options: Any) -> Spectrum:
        from ..image.formats.radmc3d import FLUX
        from ..observing import spectrum

        if self.request.aperture:
            return self._through_apertures(**options)
        if self.request.circular:
            return self._of_rings(**options)
        given = {**self.how("radmc3d"), **options, "distance": PARSEC, "tolerance": None}
        return spectrum(self.volume, self.medium(), self.camera(), **given).to(FLUX)

    def _through_apertures(self, **options: Any) -> Spectrum:
        """Return fluxes of pictures within ``aperture_info.inp``'s circles.

        Pixels count if their centres are within.
        """
        from ..observing import observe

        request = self.request
        if min(request.nx, request.ny) < _LEAST_APERTURE:
            raise InputError(f"useapert needs npix of at least {_LEAST_APERTURE}")
        waves, radii = self.model.apertures
        order = np.argsort(waves)
        ends = 1e4 * LIGHT / waves[order]
        ends[[0, -1]] *= _WIDENED
        own = self.frequencies
        if own.max() > ends[0] or own.min() < ends[-1]:
            raise InputError(
                f"aperture_info.inp has wavelengths from {waves.min():g} to {waves.max():g} "
                f"micron, not those from {self.wavelengths.min():g} to {self.wavelengths.max():g}"
            )
        logs = np.interp(-np.log(own), -np.log(ends), np.log(radii[order]))
        angles = np.exp(logs)
        medium, fluxes = self.medium(), []
        for frequency, angle in zip(self.frequencies, angles, strict=True):
            half = float(angle * _APERTURE_AU * (request.dpc or 1.0))
            how = {**self.how("radmc3d"), "frequencies": np.array([frequency])}
            cube = observe(self.volume, medium, self.camera((half, half)), **how, **options)
            inside = np.hypot(*np.meshgrid(cube.x / half, cube.y / half)) <= 1.0
            area = float(np.prod(cube.pixel_size))
            fluxes.append(np.sum(cube.intensity[inside, 0].astype(np.float64)) * area)
        return self._fluxes(np.array(fluxes) / PARSEC**2)

    def _of_rings(self, **options: Any) -> Spectrum:
        from ..cameras import Orthographic
        from ..observing import observe
        from ..observing.rings import Rings

        request, grid = self.request, self.volume.grid
        central = [star for star in self.model.stars if not any(star.position)]
        if "theta" not in grid.coordinates or len(self.model.stars) != 1 or not central:
            raise InputError("circ needs a spherical grid and one star, in its centre")
        radial, star = np.asarray(grid.edges[0], np.float64), float(central[0].radius)
        inner = np.append(np.arange(1.0, _INNER + 1), _INNER + 0.5) / (_INNER + 1.0)
        inside = star + inner * (radial[0] - star)
        radii = np.concatenate([inside, radial[:-2] * (1.0 + _OFF_WALLS)])
        walls = np.concatenate([[star], 0.5 * (radii[1:] + radii[:-1])])
        walls = np.append(walls, 2.0 * walls[-1] - walls[-2])
        azimuths = 1 if grid.shape[1:] == (1, 1) else _AZIMUTHS
        angles = (request.incl, request.phi, request.posang)
        rings = Rings(walls, radii, azimuths, *angles, center=(0.0, 0.0, 0.0))
        how, medium = {**self.how(None), **options}, self.medium()
        cube = observe(self.volume, medium, rings, **{**how, "objects": []})
        total = np.sum(cube.intensity.astype(np.float64) * rings.areas[:, :, None], axis=(0, 1))
        if how["objects"]:
            disc = Orthographic(
                *angles, width=1e-6 * star * grid.unit, resolution=1, center=(0.0, 0.0, 0.0)
            )
            how["objects"] = [self._spheres()]
            middle = observe(self.volume, medium, disc, **how).intensity[0, 0]
            total = total + np.pi * star**2 * middle
        return self._fluxes(total / PARSEC**2)

    def _fluxes(self, fluxes: np.ndarray) -> Spectrum:
        from ..image.formats.radmc3d import FLUX
        from ..image.spectral_axis import SpectralAxis
        from ..image.spectrum import Spectrum

        axis = SpectralAxis(self.frequencies, "Hz")
        return Spectrum(axis, fluxes, unit=FLUX, distance=PARSEC)


def drawn(folder: Path, words: str, progress: Progress = None) -> Image | Spectrum:
    """Return what RADMC-3D's words make of a model, in double precision; nothing is written."""
    session = Session.of(request_of(words.split()), folder)
    return session.result(precision="double", progress=progress)
