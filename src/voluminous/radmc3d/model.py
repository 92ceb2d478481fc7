"""What the folder of a RADMC-3D model says besides its grid and fields: dust, molecules, stars."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import FileFormatError
from ..files import MissingPathError, as_path, missing
from ..io.fortran import TextFile, before_comment, fortran_numbers
from ..io.guard import reading
from ..physics.constants import RADMC3D, Reals
from ..physics.molecule import Molecule
from ..physics.opacity import MICRON, Opacity
from ..physics.spectra import Blackbody, TabulatedSpectrum

Spectrum = Blackbody | TabulatedSpectrum
# pc²/π in cm²: from the flux at 1 pc to the intensity on a star of that radius, with its parsec.
_FLUX_TO_INTENSITY = 3.0308410e36
# Wavelengths of stars must be the model's to this relative difference, as RADMC-3D asks for.
_SAME = 1e-3
_OPACITY_FILES = {1: "dustkappa_{}.inp", 10: "dustkapscatmat_{}.inp"}
_MOLECULE = re.compile(r"(\S+) leiden \d+ \d+(?: (\d{1,3})(?= |$)|$)")
_SETTING = re.compile(r"\s*(\w+)\s*=\s*([^\s;#!]+)")


class Star(NamedTuple):
    """A star: radius in cm, mass in g, position in cm, and the intensity on its surface."""

    radius: float
    mass: float
    position: Reals
    spectrum: Spectrum


def read_model(folder: str | PathLike[str]) -> ModelFolder:
    """Return what a folder of RADMC-3D says; each file is read when it is first asked for."""
    path = as_path(folder)
    if not path.is_dir():
        raise missing(path)
    return ModelFolder(path)


class ModelFolder:
    """The files of a model that have no values on cells.

    An attribute whose file is missing or damaged raises an error that names it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def __repr__(self) -> str:
        return f"<ModelFolder {self.path}>"

    @cached_property
    def wavelengths(self) -> Reals:
        """The global wavelengths in micron, in the order of ``wavelength_micron.inp``, (n,)."""
        with self._open("wavelength_micron.inp", "the wavelengths of the model") as source:
            return _list(source, "wavelengths")

    @cached_property
    def frequencies(self) -> Reals:
        """The global frequencies in Hz, rising, (n,)."""
        return np.sort(RADMC3D.c / (MICRON * self.wavelengths))

    @cached_property
    def opacities(self) -> tuple[Opacity, ...]:
        """The opacities of the species of dust, in the order of ``dustopac.inp``."""
        names = []
        with self._open("dustopac.inp", "the species of dust") as source:
            _expect(source, (2,))
            (count,) = source.integers(1, "the number of species")
            source.comment()
            for _ in range(count):
                (style,) = source.integers(1, "the kind of input")
                source.tokens("whether the grains are thermal")
                name = source.tokens("the name of a species")[0].decode("ascii", "replace")
                if style not in _OPACITY_FILES:
                    raise FileFormatError(
                        f"species {name} has input of kind {style}; expected 1 or 10, for "
                        f"dustkappa_{name}.inp or dustkapscatmat_{name}.inp"
                    )
                names.append((name, _OPACITY_FILES[style].format(name)))
                source.comment()
        return tuple(
            Opacity.open(self._path(file, f"the opacity of {name}"), name).replace(
                grid=self.frequencies
            )
            for name, file in names
        )

    @cached_property
    def molecules(self) -> dict[str, Molecule]:
        """The molecules by name, in the order of ``lines.inp``."""
        names = []
        with self._open("lines.inp", "which molecules the model has") as source:
            number = _expect(source, (1, 2))
            (count,) = source.integers(1, "the number of molecules")
            for _ in range(count):
                row = b" ".join(source.tokens("a molecule")).decode("ascii", "replace")
                match = _MOLECULE.match(row)
                if match is None:
                    raise FileFormatError(
                        f"line {source.line}: expected a molecule as 'NAME leiden 0 0 0', the last "
                        f"being the number of collision partners, got {row!r:.60}"
                    )
                names.append(match[1])
                for _ in range(int(match[2] or 0) if number == 2 else 0):
                    source.tokens("a collision partner")
        return {name: self._molecule(name) for name in names}

    def _molecule(self, name: str) -> Molecule:
        path = self._path(f"molecule_{name}.inp", f"the levels and lines of {name}")
        molecule = Molecule.open(path, name)
        file = f"partitionfunction_{name}.inp"
        if not (self.path / file).is_file():
            return molecule
        with self._open(file, "a partition function") as source:
            _expect(source, (1,))
            (count,) = source.integers(1, "the number of temperatures")
            return molecule.replace(
                partition=tuple(source.reals(2 * count, "rows").reshape(-1, 2).T)
            )

    @cached_property
    def stars(self) -> tuple[Star, ...]:
        """The stars in ``stars.inp``; none without it."""
        if not (self.path / "stars.inp").is_file():
            return ()
        with self._open("stars.inp", "the stars") as source:
            _expect(source, (2,))
            count, waves = source.integers(2, "the numbers of stars and of wavelengths")
            bodies = source.reals(5 * count, "radius, mass and position").reshape(count, 5)
            self._check(source.reals(waves, "wavelengths"))
            spectra = [self._spectrum(source, waves, radius) for radius in bodies[:, 0]]
        return tuple(
            Star(float(body[0]), float(body[1]), body[2:], spectrum)
            for body, spectrum in zip(bodies, spectra, strict=True)
        )

    def _spectrum(self, source: TextFile, count: int, radius: float) -> Spectrum:
        tokens = source.tokens("the spectrum of a star")
        flux = fortran_numbers(b" ".join(before_comment(tokens)), source.line)
        if flux[0] < 0.0:
            return Blackbody(float(-flux[0]), grid=self.frequencies)
        if len(flux) < count:
            flux = np.append(flux, source.reals(count - len(flux), "the spectrum of a star"))
        return TabulatedSpectrum(self.wavelengths, _FLUX_TO_INTENSITY * flux / radius**2)

    @cached_property
    def external(self) -> TabulatedSpectrum | None:
        """The intensity of the background, of ``external_source.inp``; None without it."""
        if not (self.path / "external_source.inp").is_file():
            return None
        with self._open("external_source.inp", "the background") as source:
            _expect(source, (2,))
            (count,) = source.integers(1, "the number of wavelengths")
            self._check(source.reals(count, "wavelengths"))
            return TabulatedSpectrum(self.wavelengths, source.reals(count, "intensities"))

    @cached_property
    def camera_wavelengths(self) -> Reals:
        """Wavelengths in micron of ``camera_wavelength_micron.inp`` or ``camera_frequency.inp``."""
        if (self.path / "camera_frequency.inp").is_file():
            with self._open("camera_frequency.inp", "frequencies") as source:
                return RADMC3D.c / (MICRON * _list(source, "frequencies"))
        with self._open("camera_wavelength_micron.inp", "wavelengths of pictures") as source:
            return _list(source, "wavelengths")

    @cached_property
    def apertures(self) -> tuple[Reals, Reals]:
        """Wavelengths in micron and radii in arcseconds, of ``aperture_info.inp``."""
        with self._open("aperture_info.inp", "the radii of apertures") as source:
            _expect(source, (1,))
            (count,) = source.integers(1, "the number of wavelengths")
            waves, radii = source.reals(2 * count, "wavelengths and radii").reshape(-1, 2).T
            return waves, radii

    @cached_property
    def settings(self) -> dict[str, int | float | str]:
        """What ``radmc3d.inp`` sets, by name; nothing without it."""
        path = self.path / "radmc3d.inp"
        text = path.read_text("utf-8-sig", "replace") if path.is_file() else ""
        found = (_SETTING.match(line) for line in text.splitlines())
        return {match[1]: _value(match[2]) for match in found if match}

    @property
    def line_mode(self) -> int:
        """The setting ``lines_mode``: 1 (the default) and -1 are local thermal equilibrium."""
        return int(self.settings.get("lines_mode", 1))

    def _check(self, waves: Reals) -> None:
        own = self.wavelengths
        if len(waves) != len(own) or not np.allclose(waves, own, rtol=_SAME, atol=0.0):
            raise FileFormatError("its wavelengths must be those of wavelength_micron.inp")

    def _path(self, name: str, what: str) -> Path:
        path = self.path / name
        if not path.is_file():
            raise MissingPathError(f"there is no file {path}, which says {what}")
        return path

    @contextmanager
    def _open(self, name: str, what: str) -> Iterator[TextFile]:
        path = self._path(name, what)
        with reading(path, what), TextFile(path) as source:
            yield source


def _expect(source: TextFile, formats: tuple[int, ...]) -> int:
    number = source.format(False)
    if number not in formats:
        expected = " or ".join(map(str, formats))
        raise FileFormatError(f"line {source.line}: expected format {expected}, got {number}")
    return number


def _list(source: TextFile, what: str) -> Reals:
    (count,) = source.integers(1, f"the number of {what}")
    values = source.reals(count, what)
    if count < 1 or not np.all((values > 0.0) & (values < np.inf)):
        raise FileFormatError(f"{what} must be positive numbers")
    return values


def _value(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(re.sub("(?<=[0-9.])[dD](?=[-+0-9])", "e", text))
        except ValueError:
            continue
    return text
