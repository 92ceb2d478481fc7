"""Convert a data file to another format; tell what that format could not hold."""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, VoluminousError
from .common import say
from .data import DataFile, add_fields_option, add_reading_options, bytes_of, data_file, in_bytes

if TYPE_CHECKING:
    from ..io import Reader
    from ..volume import Volume


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("source", type=Path, metavar="FROM", help="data file to read")
    parser.add_argument(
        "target", type=Path, metavar="TO", help="file to write; its suffix says how"
    )
    parser.add_argument(
        "--to", metavar="FORMAT", help="format to write, if the suffix does not tell"
    )
    add_fields_option(parser, "fields to write; all by default")
    parser.add_argument(
        "--expr",
        action="append",
        default=[],
        metavar="NAME=EXPRESSION",
        help="field to add, computed of the others; may be given several times",
    )
    parser.add_argument(
        "--resample",
        metavar="NXxNYxNZ",
        help="means on a Cartesian grid of so many equal cells, such as 256x256x256",
    )
    parser.add_argument("--compress", action="store_true", help="pack it, where the format can")
    parser.add_argument("--overwrite", action="store_true", help="replace a file that is there")
    add_reading_options(parser)
    parser.add_argument("-q", "--quiet", action="store_true", help="say nothing but errors")


def run(args: argparse.Namespace) -> int:
    """Read, convert and write the file; list what the output format cannot hold."""
    from ..io.saving import writer_for

    start = time.perf_counter()
    data = data_file(args.source, args)
    _check_target(args)
    writer = writer_for(args.target, args.to)
    options = _writing_options(writer, args.compress)
    volume = _changed(data, args)
    volume.save(args.target, format=writer.name, **options)
    names = ", ".join(volume.fields)
    say(
        args.quiet,
        f"{args.target}: {writer.description}, {in_bytes(bytes_of(args.target))}, "
        f"{time.perf_counter() - start:.1f} s",
        f"  {names} on {volume.grid!r}",
        *losses(volume, args.target, writer),
    )
    return 0


def _check_target(args: argparse.Namespace) -> None:
    target: Path = args.target
    if target.exists() and not args.overwrite and not _is_empty_directory(target):
        raise InputError(f"{target} is there already; give another name, or --overwrite")
    if not target.resolve().parent.is_dir():
        raise InputError(f"the directory {target.parent} does not exist; create it first")


def _is_empty_directory(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())


def _writing_options(writer: Reader, compress: bool) -> dict[str, Any]:
    if not compress:
        return {}
    if "compress" not in writer.write_options:
        raise InputError(f"--compress: the format {writer.name} has no such option")
    return {"compress": True}


def _changed(data: DataFile, args: argparse.Namespace) -> Volume:
    volume = _with_expressions(data, args.expr) if args.expr else data.open()
    if args.resample is None:
        return volume
    from ..grids import CartesianGrid

    grid = volume.grid
    fine = CartesianGrid.uniform(_counts(args.resample), grid.bounds, unit=grid.unit)
    coarse = volume.resample(fine)
    coarse.meta.update(volume.meta)
    if volume.wcs is not None:
        say(args.quiet, "left out: the world coordinates (WCS), which are those of the old cells")
    return coarse


def _with_expressions(data: DataFile, expressions: list[str]) -> Volume:
    """Return the requested and the computed fields; expressions may use any field of the file."""
    if isinstance(data.fields, list):
        volume = replace(data, fields=None).open()
        asked = [name for name in data.fields if name not in _names(expressions)]
        kept = set(data.open(asked).fields) if asked else set()
    else:
        volume = data.open()
        kept = set(volume.fields)
    for text in expressions:
        name, equals, expression = text.partition("=")
        if not equals or not name.strip() or not expression.strip():
            raise InputError(f"--expr expects NAME=EXPRESSION, got {text!r}")
        volume[name.strip()] = expression.strip()
        kept.add(name.strip())
    for name in volume.fields:
        if name not in kept:
            del volume[name]
    return volume


def _names(expressions: list[str]) -> set[str]:
    return {text.partition("=")[0].strip() for text in expressions}


def _counts(text: str) -> tuple[int, ...]:
    match = re.fullmatch(r"\s*(\d+)\s*[x×,]\s*(\d+)\s*[x×,]\s*(\d+)\s*", text)
    if match is None or not all(int(n) for n in match.groups()):
        raise InputError(f"--resample expects three numbers such as 256x256x256, got {text!r}")
    return tuple(int(n) for n in match.groups())


def losses(volume: Volume, path: Path, writer: Reader) -> Iterator[str]:
    """Yield a line for each item of the volume that the written file does not contain."""
    from ..io.registry import open_lazily

    try:
        again = open_lazily(path, format=writer.name)
    except VoluminousError as error:
        yield f"  it cannot be read back: {error}"
        return
    yield from _grid(volume, again)
    yield from _fields(volume, again)
    lost = [key for key in volume.meta if key not in again.meta]
    if lost:
        yield f"  left out: {', '.join(lost)}"
    if volume.wcs is not None and again.wcs is None:
        yield "  left out: the world coordinates (WCS)"


def _grid(volume: Volume, again: Volume) -> Iterator[str]:
    mine, theirs = volume.grid.describe(), again.grid.describe()
    if mine["type"] != theirs["type"]:
        yield f"  the grid is {theirs['type']} there, {mine['type']} here"
    elif _unit(mine) != _unit(theirs):
        yield f"  lengths are in {_unit(theirs)} there, in {_unit(mine)} here"


def _unit(told: dict[str, Any]) -> str:
    return told["unit"] or "no unit"


def _fields(volume: Volume, again: Volume) -> Iterator[str]:
    mine, theirs = volume.describe()["fields"], again.describe()["fields"]
    lost = [name for name in mine if name not in theirs]
    new = [name for name in theirs if name not in mine]
    pairs = {name: name for name in mine if name in theirs}
    if len(lost) == len(new) == 1:  # formats with a single field store no names
        yield f"  {lost[0]} is called {new[0]} there"
        pairs[lost[0]] = new[0]
    elif lost:
        yield f"  not there by that name: {', '.join(lost)}"
    for name, other in pairs.items():
        yield from _field(name, mine[name], theirs[other])


def _field(name: str, mine: dict[str, Any], theirs: dict[str, Any]) -> Iterator[str]:
    for key in ("dtype", "unit"):
        if mine[key] != theirs[key]:
            yield f"  {name}: {key} {mine[key] or 'none'} became {theirs[key] or 'none'}"
