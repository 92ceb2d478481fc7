"""Convert a data file to another format; tell what that format could not hold."""

from __future__ import annotations

import argparse
import math
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, VoluminousError
from ..memory import fits
from .common import add_quiet, add_several, assignment, check_directory, say
from .data import DataFile, add_fields_option, add_reading_options, bytes_of, data_file, in_bytes

if TYPE_CHECKING:
    from ..io import Reader
    from ..volume import Volume

# Options that are passed on to the writer.
_OPTIONS = ("compress", "levels", "stats", "keep_bits", "chunks")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("source", type=Path, metavar="FROM", help="data file to read")
    help = "file to write; its suffix says how"
    parser.add_argument("target", type=Path, metavar="TO", help=help)
    help = "format to write, if the suffix does not tell"
    parser.add_argument("--to", metavar="FORMAT", help=help)
    add_fields_option(parser, "fields to write; all by default")
    help = "field to add, computed of the others; may be given several times"
    add_several(parser, "--expr", "NAME=EXPRESSION", help)
    help = "means on a Cartesian grid of so many equal cells, such as 256x256x256"
    parser.add_argument("--resample", metavar="NXxNYxNZ", help=help)
    parser.add_argument("--compress", action="store_true", help="pack it, where the format can")
    help = "add coarser levels (Zarr): means over 2x2x2 cells, and so on"
    parser.add_argument("--levels", action="store_true", help=help)
    help = "add the least and the largest value of each chunk (Zarr)"
    parser.add_argument("--stats", action="store_true", help=help)
    help = "bits of the fraction to keep of real numbers (Zarr): 10 change them by up to 5e-4"
    parser.add_argument("--keep-bits", type=int, metavar="N", help=help)
    help = "cells along the sides of a chunk (Zarr): 128 if not given"
    parser.add_argument("--chunks", type=int, metavar="N", help=help)
    parser.add_argument("--overwrite", action="store_true", help="replace a file that is there")
    add_reading_options(parser)
    add_quiet(parser)


def run(args: argparse.Namespace) -> int:
    """Read, convert and write the file; list what the output format cannot hold."""
    from ..io.registry import writer_for
    from ..progress import progress_bar

    start, target = time.perf_counter(), args.target
    data = data_file(args.source, args)
    is_empty_directory = target.is_dir() and not any(target.iterdir())
    if target.exists() and not args.overwrite and not is_empty_directory:
        raise InputError(f"{target} is there already; give another name, or --overwrite")
    check_directory(target)
    writer = writer_for(target, args.to)
    given = {name: getattr(args, name) for name in _OPTIONS}
    options = {
        name: value for name, value in given.items() if value is not None and value is not False
    }
    for name in options:
        if name not in writer.write_options:
            option = name.replace("_", "-")
            raise InputError(f"--{option}: the format {writer.name} has no such option")
    volume = _with_expressions(data, args.expr) if args.expr else data.open()
    if args.resample is not None:
        volume = _resampled(volume, args)
    with progress_bar(False if args.quiet else None, "converting"):
        volume.save(target, format=writer.name, **options)
    seconds = time.perf_counter() - start
    say(
        args.quiet,
        f"{target}: {writer.description}, {in_bytes(bytes_of(target))}, {seconds:.1f} s",
        f"  {', '.join(volume.fields)} on {volume.grid!r}",
        *losses(volume, target, writer),
    )
    return 0


def _resampled(volume: Volume, args: argparse.Namespace) -> Volume:
    from ..geometry import CARTESIAN
    from ..grids import CartesianGrid
    from ..grids.contract import BoxGrid

    match = re.fullmatch(r"\s*(\d+)\s*[x×,]\s*(\d+)\s*[x×,]\s*(\d+)\s*", args.resample)
    counts = tuple(int(n) for n in match.groups()) if match else (0,)
    if not all(counts):
        raise InputError(
            f"--resample expects three numbers such as 256x256x256, got {args.resample!r}"
        )
    grid = volume.grid
    # What does not fit is made chunk by chunk, while it is written.
    boxes = isinstance(grid, BoxGrid) and tuple(grid.coordinates) == CARTESIAN
    large = boxes and not fits(8 * (len(volume.fields) + 4) * math.prod(counts))
    target = CartesianGrid.uniform(counts, grid.bounds, unit=grid.unit)
    coarse = volume.resample(target, deferred=large)
    coarse.meta.update(volume.meta)
    if volume.wcs is not None:
        say(args.quiet, "left out: the world coordinates (WCS), which are those of the old cells")
    return coarse


def _with_expressions(data: DataFile, expressions: list[str]) -> Volume:
    """Return the requested and the computed fields; expressions may use any field of the file."""
    new = dict(assignment(text, "--expr", "NAME=EXPRESSION") for text in expressions)
    if isinstance(data.fields, list):
        volume = replace(data, fields=None).open()
        asked = [name for name in data.fields if name not in new]
        wanted = set(data.open(asked).fields) if asked else set()
    else:
        volume = data.open()
        wanted = set(volume.fields)
    for name, expression in new.items():
        volume[name] = expression
    for name in volume.fields:
        if name not in wanted and name not in new:
            del volume[name]
    return volume


def losses(volume: Volume, path: Path, writer: Reader) -> Iterator[str]:
    """Yield a line for each item of the volume that the written file does not contain."""
    from ..io.registry import open_lazily

    try:
        again = open_lazily(path, format=writer.name)
    except VoluminousError as error:
        yield f"  it cannot be read back: {error}"
        return
    here, there = (v.grid.describe() for v in (volume, again))
    units = [grid["unit"] or "no unit" for grid in (here, there)]
    if here["type"] != there["type"]:
        yield f"  the grid is {there['type']} there, {here['type']} here"
    elif units[0] != units[1]:
        yield f"  lengths are in {units[1]} there, in {units[0]} here"
    yield from _changed_fields(volume.describe()["fields"], again.describe()["fields"])
    if lost := [key for key in volume.meta if key not in again.meta]:
        yield f"  left out: {', '.join(lost)}"
    if volume.wcs is not None and again.wcs is None:
        yield "  left out: the world coordinates (WCS)"


def _changed_fields(here: dict[str, Any], there: dict[str, Any]) -> Iterator[str]:
    lost = [name for name in here if name not in there]
    new = [name for name in there if name not in here]
    pairs = {name: name for name in here if name in there}
    if len(lost) == len(new) == 1:  # formats with a single field store no names
        yield f"  {lost[0]} is called {new[0]} there"
        pairs[lost[0]] = new[0]
    elif lost:
        yield f"  not there by that name: {', '.join(lost)}"
    for name, other in pairs.items():
        for key in ("dtype", "unit"):
            old, now = here[name][key], there[other][key]
            if old != now:
                yield f"  {name}: {key} {old or 'none'} became {now or 'none'}"
