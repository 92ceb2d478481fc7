"""Reads molecules: files of the Leiden database, and catalogues of JPL and CDMS."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError, InputError
from ..files import as_path, missing
from ..io.fortran import TextFile, before_comment, fortran_numbers
from ..io.guard import reading
from .constants import CODATA
from .molecule import Molecule

# FREQ, ERR, LGINT, DR, ELO, GUP, TAG, QNFMT, QN', QN" (Pickett et al. 1998, JQSRT 60, 883).
_ENDS = np.cumsum([0, 13, 8, 8, 2, 10, 3, 7, 4, 12, 12])
# Columns may touch: of a weight of three signs and an energy, for example.
_CARD = re.compile(
    "".join(rf"(?= *-?\d*\.\d)[- \d.]{{{n}}}" for n in (13, 8, 8))
    + r"[- ]\d(?= *-?\d*\.\d)[- \d.]{10}[ \w][ \d]\d[- \d]{6}\d"
)
_REFERENCE = 300.0  # K, of the intensities
_TO_RATE = 2.7964e-16  # 1/s per nm² MHz³
# Temperatures in K at which the partition function of a catalogue is tabulated, dense enough for
# linear interpolation to keep 1e-5.
_TEMPERATURES = np.geomspace(1.0, 5000.0, 1000)
_TABLES = (".ecsv", ".fits", ".csv", ".vot", ".xml")


def read(
    path: str | PathLike[str],
    name: str | None = None,
    partition: Mapping[float, float] | None = None,
) -> Molecule:
    """Return the molecule in a file; see `Molecule.open`."""
    path = as_path(path)
    if not path.is_file():
        raise missing(path)
    with reading(path, "a file of the Leiden database, or a catalogue of JPL or CDMS"):
        if path.suffix in _TABLES:
            from astropy.table import Table

            return _of_catalogue(_columns(Table.read(path)), name or path.stem, partition)
        try:
            cards = _cards(path)
        except ValueError as error:
            raise FileFormatError(
                f"a line does not have a catalogue's 80 columns: {error}"
            ) from error
        if cards is not None:
            return _of_catalogue(cards, name or path.stem, partition)
        with TextFile(path) as source:
            molecule = _of_leiden(source, name)
    return molecule if partition is None else molecule.replace(partition=_dense(partition))


def _of_leiden(source: TextFile, name: str | None) -> Molecule:
    source.comment()
    named = source.tokens("the molecule's name")[0].decode("ascii", "replace")
    source.comment()
    (weight,) = _numbers(source, 1, "the molecular weight")[0]
    source.comment()
    (count,) = source.integers(1, "the number of levels")
    source.comment()
    levels, labels = _rows(source, count, 3, "level")
    source.comment()
    (lines,) = source.integers(1, "the number of lines")
    source.comment()
    rows, _ = _rows(source, lines, 5, "line")
    if not np.all((rows[:, 1:3] >= 1) & (rows[:, 1:3] <= count)):
        raise FileFormatError(f"lines must go between levels 1 to {count}")
    up, low = (rows[:, k].astype(int) - 1 for k in (1, 2))
    return Molecule(
        name or named,
        weight,
        levels[:, 1],
        levels[:, 2],
        labels,
        up,
        low,
        rows[:, 3],
        rows[:, 4] * 1e9,
    )


def _numbers(source: TextFile, count: int, what: str) -> tuple[np.ndarray, list[bytes]]:
    tokens = source.tokens(f"{what}: expected {count} numbers")
    if len(tokens) < count:
        raise FileFormatError(
            f"line {source.line}: {what}: expected {count} numbers, got {len(tokens)}"
        )
    return fortran_numbers(b" ".join(tokens[:count]), source.line), tokens[count:]


def _rows(source: TextFile, count: int, width: int, what: str) -> tuple[np.ndarray, list[str]]:
    rows = [_numbers(source, width, f"{what} {k + 1} of {count}") for k in range(count)]
    labels = [
        b" ".join(before_comment(words)).decode("ascii", "replace") or str(k + 1)
        for k, (_, words) in enumerate(rows)
    ]
    return np.array([row for row, _ in rows]).reshape(count, width), labels


def _cards(path: Path) -> dict[str, Any] | None:
    """Return the columns of a catalogue of fixed width; None of another file."""
    text = path.read_text("utf-8-sig", "replace").splitlines()
    cards = [line.ljust(int(_ENDS[-1])) for line in text if _CARD.match(line)]
    if not cards or not any(_CARD.match(line) for line in text[:3]):
        return None
    for number, line in enumerate(text, start=1):
        if re.match(r"\s*\d*\.\d", line) and not _CARD.match(line):
            raise FileFormatError(
                f"line {number}: expected a line of a catalogue, got {line!r:.60}"
            )
    rows = [[card[first:end] for first, end in pairwise(_ENDS)] for card in cards]
    nu, _, intensity, _, energy, weight, tag, _, up, low = zip(*rows, strict=True)
    return {
        "FREQ": np.array(nu, dtype=float),
        "LGINT": np.array(intensity, dtype=float),
        "ELO": np.array(energy, dtype=float),
        "GUP": np.array([_weight(g) for g in weight]),
        "TAG": np.array(tag, dtype=float),
        "up": [_quanta(q) for q in up],
        "low": [_quanta(q) for q in low],
    }


def _columns(table: Any) -> dict[str, Any]:
    needed = ("FREQ", "ELO", "GUP", "LGAIJ" if "LGAIJ" in table.colnames else "LGINT")
    absent = [name for name in needed if name not in table.colnames]
    if absent:
        raise FileFormatError(
            f"it has no columns {', '.join(absent)}; expected a table of astroquery"
        )
    columns: dict[str, Any] = {n: np.asarray(table[n], float) for n in needed if n != "GUP"}
    columns["GUP"] = np.array([_weight(str(g)) for g in table["GUP"]])
    # Of CDMS astroquery's TAG has no weight: 503 of 28503. A sign tells of measured lines.
    tag, weight = (
        np.abs(np.asarray(table[n], float)) if n in table.colnames else 0.0
        for n in ("TAG", "MOLWT")
    )
    columns["TAG"] = np.where(tag < 1000.0, tag + 1000.0 * weight, tag)
    if not np.all(columns["TAG"] >= 1000.0):
        raise FileFormatError("it has no column TAG or MOLWT; expected a table of astroquery")
    for label, kinds in (("up", ("QN'", "Ju", "Ku", "vu")), ("low", ('QN"', "Jl", "Kl", "vl"))):
        names = [n for n in table.colnames if n in kinds or re.fullmatch(f"{kinds[0]}\\d", n)]
        if not names:  # CDMS's Q1 … Q12: the first half is of the upper level
            quanta = [n for n in table.colnames if re.fullmatch(r"Q\d+", n)][:12]
            names = quanta[:6] if label == "up" else quanta[6:]
        columns[label] = [
            " ".join(str(row[n]).strip() for n in names if str(row[n]).strip() not in ("--", ""))
            for row in table
        ]
    return columns


def _weight(text: str) -> float:
    """Return g; 1000 and more begin with a letter: A05 is 1005."""
    text = text.strip()
    if text[:1].isalpha():
        return 100.0 * (ord(text[0].upper()) - ord("A") + 10) + float(text[1:])
    return float(text)


def _quanta(text: str) -> str:
    parts = [text[k : k + 2].strip() for k in range(0, len(text), 2)]
    return " ".join(part for part in parts if part)


def _of_catalogue(
    columns: dict[str, Any], name: str, partition: Mapping[float, float] | None
) -> Molecule:
    if len(set(np.abs(columns["TAG"]))) > 1:
        raise FileFormatError("it has lines of several molecules; give a catalogue of one")
    if not partition:
        raise InputError(
            "a catalogue has no partition function; give it at some temperatures in K: "
            "partition={300: 108.9, 150: 54.6, …}, as in CDMS's list of partition functions"
        )
    nu, energy, weight = (columns[key] for key in ("FREQ", "ELO", "GUP"))
    per_hz = 1.0 / CODATA.c  # cm⁻¹ per Hz
    upper = energy + 1e6 * nu * per_hz
    labels, energies, weights, ends = _levels(columns, upper)
    table = _dense(partition)
    if "LGAIJ" in columns:
        rates = 10.0 ** columns["LGAIJ"]
    else:
        q = _power_law(partition, np.array([_REFERENCE]))[0]
        low, high = (np.exp(-CODATA.boltzmann * e / _REFERENCE) for e in (energy, upper))
        rates = _TO_RATE * 10.0 ** columns["LGINT"] * nu**2 * q / weight / (low - high)
    mass = float(abs(columns["TAG"][0]) // 1000)
    return Molecule(name, mass, energies, weights, labels, *ends, rates, 1e6 * nu, table)


def _levels(
    columns: dict[str, Any], upper: np.ndarray
) -> tuple[list[str], list[float], list[float], tuple[list[int], list[int]]]:
    """Return labels, energies and weights of the levels, and those of each line.

    The energy of a level is that of its lines as a lower one where there are any. The weight of a
    level that is no upper one is not listed; nothing in equilibrium depends on it, and 1 is taken.
    """
    known: dict[str, list[float]] = {}
    for label, energy in zip(columns["low"], columns["ELO"], strict=True):
        known.setdefault(label, [energy, 1.0])
    for label, energy, weight in zip(columns["up"], upper, columns["GUP"], strict=True):
        known.setdefault(label, [energy, weight])[1] = weight
    if min(energy for energy, _ in known.values()) > 0.0:
        known["ground"] = [0.0, 1.0]  # energies count from it, whether a line ends there or not
    labels = sorted(known, key=lambda label: known[label][0])
    place = {label: k for k, label in enumerate(labels)}
    ends = [place[q] for q in columns["up"]], [place[q] for q in columns["low"]]
    energies, weights = zip(*(known[label] for label in labels), strict=True)
    return labels, list(energies), list(weights), ends


def _dense(partition: Mapping[float, float]) -> tuple[np.ndarray, np.ndarray]:
    return _TEMPERATURES, _power_law(partition, _TEMPERATURES)


def _power_law(partition: Mapping[float, float], at: np.ndarray) -> np.ndarray:
    """Return the partition function: a power law between temperatures, and beyond; at least 1."""
    t, z = np.array(sorted((float(t), float(z)) for t, z in partition.items())).T
    if len(t) < 2 or not (np.all(t > 0.0) and np.all(z > 0.0)):
        raise InputError("expected a partition function at two or more temperatures in K")
    k = np.clip(np.searchsorted(t, at) - 1, 0, len(t) - 2)
    slope = np.log(z[k + 1] / z[k]) / np.log(t[k + 1] / t[k])
    return np.asarray(np.maximum(z[k] * (at / t[k]) ** slope, 1.0))
