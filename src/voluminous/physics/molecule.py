"""Molecules: levels, transitions and partition functions."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..units import as_given, is_listed, is_quantity, shown
from ..value import Value
from .constants import CODATA, Constants, Reals, constants_named, in_unit
from .opacity import listed

Indices = NDArray[np.int64]
# A frequency names the line that is this near, relative to it: other lines may be, too.
_NEAR = 1e-3
_SHOWN = 8


class Molecule(Value):
    """The levels and lines of a molecule, atom or ion.

    Parameters
    ----------
    name : str
        Such as ``"co"``.
    weight : float
        Molecular weight: its mass in atomic mass units.
    energies : array, shape (n,)
        Of the levels, in cm⁻¹.
    weights : array, shape (n,)
        Statistical weights g of the levels.
    labels : list of str, length n
        Quantum numbers of the levels.
    up, low : array of int, shape (m,)
        The levels of each line, counted from 0.
    einstein_a : array, shape (m,)
        Einstein's A in 1/s.
    frequencies : array, shape (m,)
        In Hz.
    partition : (temperatures, values), optional
        The partition function in a table, linear between temperatures in K; without it the levels
        are summed.

    Raises
    ------
    InputError
        If the arrays do not fit each other.
    """

    def __init__(
        self,
        name: str,
        weight: float,
        energies: Any,
        weights: Any,
        labels: Sequence[str],
        up: Any,
        low: Any,
        einstein_a: Any,
        frequencies: Any,
        partition: tuple[Any, Any] | None = None,
    ) -> None:
        what = f"molecule {name}"
        if not is_listed(labels) and not isinstance(labels, str):
            raise InputError(f"{what}: labels are a list of texts, got {shown(labels)}")
        self.name, self.labels = str(name), tuple(map(str, labels))
        (self.weight,) = listed([weight], None, f"{what}: weight").tolist()
        self.energies = listed(energies, None, f"{what}: energies")
        self.weights = listed(weights, None, f"{what}: weights")
        self.up, self.low = (
            _numbers(levels, f"{what}: {end}") for end, levels in (("up", up), ("low", low))
        )
        self.einstein_a = listed(einstein_a, None, f"{what}: einstein_a")
        self.frequencies = listed(frequencies, None, f"{what}: frequencies")
        self.partition: tuple[Reals, Reals] | None = None
        levels, lines = len(self.labels), len(self.frequencies)
        shapes = {len(self.energies), len(self.weights)}, {len(self.up), len(self.low)}
        ends = np.concatenate([self.up, self.low])
        if shapes != ({levels}, {lines}) or len(self.einstein_a) != lines or not levels:
            raise InputError(f"molecule {name}: expected one number for each level, and each line")
        if not np.all((ends >= 0) & (ends < levels)) or np.any(self.up == self.low):
            raise InputError(f"molecule {name}: lines go between two of its {levels} levels")
        positive = np.concatenate([[self.weight], self.weights, self.frequencies])
        finite = np.isfinite([*positive, *self.energies, *self.einstein_a])
        if not (np.all(positive > 0.0) and np.all(finite) and np.all(self.einstein_a >= 0.0)):
            raise InputError(
                f"molecule {name}: weights and frequencies must be positive, and all numbers finite"
            )
        if partition is not None:
            if not is_listed(partition) or len(partition) != 2:
                raise InputError(
                    f"{what}: partition is (temperatures, values), got {shown(partition)}"
                )
            t, z = (listed(part, None, f"{what}: partition") for part in partition)
            if t.shape != z.shape or not (np.all(np.diff(t) > 0.0) and np.all(z > 0)):
                raise InputError(
                    f"molecule {name}: a partition function is (temperatures, values): as many "
                    "positive values as temperatures, which rise"
                )
            self.partition = t, z

    @classmethod
    def open(
        cls,
        path: str | PathLike[str],
        name: str | None = None,
        *,
        partition: Mapping[float, float] | None = None,
    ) -> Molecule:
        """Return the molecule in a file.

        Parameters
        ----------
        path : path
            A file of the Leiden database (LAMDA), such as RADMC-3D's ``molecule_NAME.inp``; the
            lines of a catalogue of JPL or CDMS (80 columns); or a table of ``astroquery`` that was
            saved (``.ecsv`` …), with the columns FREQ, LGINT (or LGAIJ), ELO, GUP, TAG.
        name : str, optional
            The one in the file, or the file's name, by default.
        partition : {temperature: value}, optional
            The partition function at two or more temperatures in K. Catalogues need it, at 300 K
            too: see CDMS's "partition functions" and JPL's ``catdir.cat``. Between them, and
            beyond, it is a power law: give temperatures that enclose those of the gas.

        Notes
        -----
        Catalogues have intensities I at 300 K in nm² MHz, which give A = 2.7964e-16 I ν² Q / g_u /
        (exp(-E_l/kT) - exp(-E_u/kT)) with ν in MHz (Pickett et al. 1998, JQSRT 60, 883).

        Raises
        ------
        FileFormatError
            If it is another file, or a damaged one.
        InputError
            If a catalogue comes without a partition function.
        """
        from .molecule_files import read

        return read(path, name, partition)

    def partition_function(self, temperature: Any, constants: str | Constants = CODATA) -> Reals:
        """Return Z(T) at temperatures in K, of any shape.

        It is the sum of g exp(-hc(E - E_0)/kT) over the levels, or linear between the temperatures
        of `partition`. RADMC-3D has the sum at 1000 temperatures from 0.1 to 1e5 K in equal ratios,
        and is linear between them; so is this with ``constants="radmc3d"``.
        """
        constants = constants_named(constants)
        t = in_unit(temperature, "K", "temperature")
        if np.any(t < 0.0):
            raise InputError(f"temperatures are 0 K or more, got {np.nanmin(t):.6g} K")
        if self.partition is not None:
            return np.asarray(np.interp(t, *self.partition))
        if constants.name == "radmc3d":
            nodes = 0.1 * 1e6 ** (np.arange(1000) / 999)
            return np.asarray(np.interp(t, nodes, self._sum(nodes, constants)))
        return self._sum(t, constants)

    def _sum(self, t: Reals, constants: Constants) -> Reals:
        above = constants.partition * (self.energies - self.energies[0])
        with np.errstate(divide="ignore", over="ignore"):
            return np.asarray(np.sum(self.weights * np.exp(-above / t[..., None]), axis=-1))

    def line(self, which: Any) -> int:
        """Return the index of a line, counted from 0.

        Parameters
        ----------
        which : int, str, (str, str) or Quantity
            The number of a line, counted from 1, as in its file and in RADMC-3D's ``iline``; labels
            of its levels as text, ``"2-1"`` or ``"CO 2-1"``, or as a pair ``("2", "1")``; or a
            frequency or wavelength, as a quantity or a text such as ``"230.538 GHz"``.

        Raises
        ------
        InputError
            If there is no such line, or several.
        """
        if isinstance(which, (int, np.integer)) and not isinstance(which, bool):
            if 1 <= which <= len(self.frequencies):
                return int(which) - 1
            raise InputError(f"{self.name} has lines 1 to {len(self.frequencies)}, got {which}")
        if isinstance(which, str) and re.search(
            r"\d\s*[GMTk]?Hz$|\d\s*(m|cm|mm|um|micron)$", which
        ):
            which = as_given(which, "line", "230.538 GHz")
        if is_quantity(which):
            return self._near(which)
        if not isinstance(which, (str, tuple, list)):
            raise InputError(f"a line is a number, labels or a frequency, got {shown(which)}")
        pairs = [tuple(which)] if isinstance(which, (tuple, list)) else self._pairs(str(which))
        names = [tuple(map(_plainly, map(str, pair))) for pair in pairs]
        labels = [_plainly(label) for label in self.labels]
        ends = zip(self.up.tolist(), self.low.tolist(), strict=True)
        found = [k for k, (up, low) in enumerate(ends) if (labels[up], labels[low]) in names]
        if len(found) != 1:
            raise InputError(
                f"{self.name} has {'several lines' if found else 'no line'} {which!r}; its lines: "
                f"{self._listed(found or range(len(self.frequencies)))}"
            )
        return found[0]

    def _pairs(self, text: str) -> list[tuple[str, str]]:
        first, _, rest = text.strip().partition(" ")
        if rest and first.lower() == self.name.lower():
            text = rest
        text = re.sub(r"\bJ\s*=\s*", "", text)
        return [(text[: m.start()], text[m.end() :]) for m in re.finditer("->|→|-|–", text)]

    def _near(self, which: Any) -> int:
        from astropy import units as u

        try:
            nu = float(which.to_value("Hz", u.spectral()))
        except (u.UnitConversionError, TypeError) as error:
            raise InputError(
                f"a line is named by one frequency or wavelength, got {which}"
            ) from error
        away = np.abs(self.frequencies / nu - 1.0)
        if not away.min() < _NEAR:
            nearest = np.argsort(away)[:_SHOWN]
            raise InputError(
                f"{self.name} has no line at {which}; the nearest: {self._listed(np.sort(nearest))}"
            )
        return int(away.argmin())

    def _listed(self, numbers: Any) -> str:
        lines = [
            f"{k + 1} ({self.labels[self.up[k]]}-{self.labels[self.low[k]]}, "
            f"{self.frequencies[k] / 1e9:.6g} GHz)"
            for k in list(numbers)[:_SHOWN]
        ]
        return ", ".join(lines) + (" …" if len(numbers) > _SHOWN else "")

    def __repr__(self) -> str:
        return (
            f"<Molecule {self.name}: weight {self.weight:g}, {len(self.labels)} levels, "
            f"{len(self.frequencies)} lines>"
        )


def _numbers(levels: Any, what: str) -> Indices:
    found = listed(levels, None, what)
    if not np.all(found == np.round(found)):
        raise InputError(f"{what}: expected the numbers of levels, from 0, got {shown(levels)}")
    return found.astype(np.int64)


def _plainly(label: str) -> str:
    return re.sub(r"[\s,_]+", " ", label.strip().strip("\"'").strip())
