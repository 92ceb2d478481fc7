"""Numbers in the headers of outputs that yt would believe, compared with the files there are."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError
from ..hdf5 import check as check_hdf5
from ..hdf5 import opened

_LARGEST_TEXT = 1 << 26
# Six whole numbers, an empty line, and eleven numbers.
_RAMSES_LINES = 18
# What is looked through, so that large outputs open as fast as small ones.
_MOST_RECORDS, _MOST_FILES = 20_000, 16


def check_output(path: Path) -> None:
    """Refuse an output whose header promises more than its files can hold.

    Raises
    ------
    FileFormatError
        Names the number, and what was expected; or a file in HDF5 that libhdf5 does not survive.
    """
    if re.fullmatch(r"info_\d{5}\.txt", path.name):
        _check_ramses(path)
    hierarchy = path.with_name(path.name + ".hierarchy")
    if hierarchy.is_file():
        _check_enzo(hierarchy)
        for piece in sorted(path.parent.glob(f"{path.name}.cpu*"))[:_MOST_FILES]:
            check_hdf5(piece)
    if path.is_dir():
        _check_amrex(path / "Header")


def check_places(path: Path) -> None:
    """Refuse an output in HDF5 whose cells yt would put in wrong places.

    Raises
    ------
    InputError
        Says what it is.
    """
    with opened(path) as file:
        blocks = file["Info"].attrs if "Locations" in file and "Info" in file else {}
        if np.any(blocks.get("IncludesGhost", 0)):
            raise InputError("its blocks have ghost cells; write it with ghost_zones = false")
        level = file["level_0"].attrs if "Chombo_global" in file and "level_0" in file else {}
        normal = {"geometry": 1, "logr": 0, "g_x2stretch": 1, "g_x3stretch": 1}
        bent = {name: level[name] for name, one in normal.items() if level.get(name, one) != one}
        if bent:
            told = ", ".join(f"{name} = {value}" for name, value in bent.items())
            raise InputError(
                f"Chombo grids of PLUTO are read if they are Cartesian with equal cells, got {told}"
            )
        begins = [level.get(f"domBeg{axis}", 0) for axis in (1, 2, 3)]
        if any(begins) and not path.with_name("pluto.ini").is_file():
            raise InputError(
                f"its domain begins at {begins}, which yt reads from the run's pluto.ini only: put "
                "that beside it"
            )


def _check_ramses(path: Path) -> None:
    numbers = dict(re.findall(r"^(\w+)\s*=\s*(\S+)\s*$", _text(path), re.MULTILINE))
    cpus, axes = _whole(numbers, "ncpu"), _whole(numbers, "ndim")
    lowest, highest = _whole(numbers, "levelmin"), _whole(numbers, "levelmax")
    cells, values = (
        sorted(path.parent.glob(path.name.replace("info", kind).replace(".txt", ".out*")))
        for kind in ("amr", "hydro")
    )
    if not 1 <= cpus <= len(cells):
        raise FileFormatError(f"ncpu is {cpus}, but there are {len(cells)} files of cells (amr_…)")
    if axes != 3:
        raise FileFormatError(f"ndim is {axes}, expected 3")
    # All cells of the lowest level are there; each takes more than a byte.
    size = sum(file.stat().st_size for file in cells)
    if not 1 <= lowest <= highest <= 60 or 8**lowest > 64 * size:
        raise FileFormatError(
            f"levelmin is {lowest} and levelmax {highest}, but there are {size} bytes of cells"
        )
    lines = [line.partition("=")[0].strip() for line in _text(path).splitlines()]
    # yt reads on until it meets this line, after those of fixed number.
    if "ordering type" not in lines or lines.index("ordering type") < _RAMSES_LINES:
        raise FileFormatError(f"{path.name} is cut short, or lines are missing: no 'ordering type'")
    for file in (*cells[:_MOST_FILES], *values[:_MOST_FILES]):
        _check_records(file)
    if values:
        _check_names(path.with_name("hydro_file_descriptor.txt"), values[0])


def _check_records(path: Path) -> None:
    """Check that a file is records of Fortran, with their lengths before and after, to its end."""
    with open(path, "rb") as file:
        size, place = file.seek(0, 2), 0
        file.seek(0)
        first = file.read(4)
        order: Any = "little" if first.endswith(b"\0\0") else "big"
        # Of long files the first records only: yt is to read the rest, in any case.
        for _ in range(_MOST_RECORDS):
            if place == size:
                return
            file.seek(place)
            before = file.read(4)
            place += 4 + int.from_bytes(before, order)
            file.seek(min(place, size))
            if len(before) < 4 or file.read(4) != before:
                raise FileFormatError(
                    f"{path.name} is cut short or damaged: the record that ends at byte {place} "
                    "began with another length"
                )
            place += 4


def _check_names(path: Path, values: Path) -> None:
    if not path.is_file():
        return
    named = re.findall(r"^\s*(?:\d+\s*,|variable)", _text(path), re.MULTILINE)
    with open(values, "rb") as file:
        head = file.read(24)
    # Two records, each a whole number: how many files there are, and how many variables.
    counts = [int.from_bytes(head[16:20], order) for order in ("little", "big")]
    if len(head) < 24 or min(counts) > len(named):
        raise FileFormatError(f"{path.name} has {len(named)} names for {min(counts)} variables")


def _check_enzo(path: Path) -> None:
    text = _text(path)
    # yt goes through as many grids as the last one's number.
    grids = [int(number) for number in re.findall(r"^Grid\s*=\s*(\d+)\s*$", text, re.MULTILINE)]
    if grids != list(range(1, len(grids) + 1)) or not grids:
        raise FileFormatError(f"{path.name}: grids must be numbered from 1 on, one after the other")
    for kind in ("ThisLevel", "NextLevel"):
        pattern = rf"^Pointer: Grid\[(\d+)\]->NextGrid{kind} = (\d+)\s*$"
        links = re.findall(pattern, text, re.MULTILINE)
        lacking = set(grids) - {int(grid) for grid, _ in links}
        if lacking:
            raise FileFormatError(
                f"{path.name} is cut short or damaged: grid {min(lacking)} has no NextGrid{kind}"
            )
        beyond = {int(other) for _, other in links} - set(grids) - {0}
        if beyond:
            raise FileFormatError(
                f"{path.name}: there is no grid {min(beyond)}; it tells of {len(grids)}"
            )


def _check_amrex(path: Path) -> None:
    lines = [line.split() for line in _text(path).splitlines()]
    numbers = [(1, "the number of fields", lines[1])] if len(lines) > 1 else []
    # Levels begin after names of fields, widths of cells of each level, and 12 further lines.
    whole = [int(words[0]) if words and words[0].isdigit() else 0 for words in lines]
    first = 13 + sum(whole[1:2]) + sum(whole[4 + sum(whole[1:2]) :][:1])
    # A level's own number, its number of grids, and the time.
    numbers += [
        (k, "the number of grids", words[1:2])
        for k, words in enumerate(lines[first:], first)
        if len(words) == 3 and words[0].isdigit() and words[1].isdigit()
    ]
    for line, what, words in numbers:
        if not (len(words) == 1 and words[0].isdigit() and int(words[0]) < len(lines)):
            raise FileFormatError(
                f"{path.name}, line {line + 1}: {what} is {' '.join(words)!r:.40}, but there are "
                f"{len(lines)} lines"
            )


def _whole(numbers: dict[str, str], name: str) -> int:
    text = numbers.get(name, "nothing")
    if not re.fullmatch(r"\d{1,9}", text):
        raise FileFormatError(f"{name} must be a whole number, got {text!r:.40}")
    return int(text)


def _text(path: Path) -> str:
    if path.stat().st_size > _LARGEST_TEXT:
        raise FileFormatError(f"{path.name} is too long for a header")
    return path.read_bytes().decode("utf-8", "replace")
