"""List the formats of data files, or the options of one."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..errors import check_name
from ..packages import install_line, is_installed

if TYPE_CHECKING:
    from ..io import Reader

_WIDTH = 100
# Maximum number of suffixes per format in the table.
_MOST = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("name", nargs="?", metavar="NAME", help="format to tell the options of")


def run(args: argparse.Namespace) -> int:
    """Print the table of formats, or the details of one format."""
    from ..io import readers

    known = {reader.name: reader for reader in readers()}
    if args.name is not None:
        check_name("format", args.name, known)
    listed = sorted(known.values(), key=lambda reader: reader.name.lower())
    print(*(_table(listed) if args.name is None else _one(known[args.name])), sep="\n")
    return 0


def _table(readers: list[Reader]) -> Iterator[str]:
    rows = [("format", "", "files", "needs", "what it is")]
    for reader in readers:
        mode = "rw" if reader.writes else "r"
        rows.append((reader.name, mode, _files(reader, _MOST), _needs(reader), _what(reader)))
    widths = [max(len(row[k]) for row in rows) for k in range(4)]
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=False)]
        yield "  ".join([*cells, row[-1]]).rstrip()
    yield ""
    yield "r: can be read (voluminous.open), w: can be written (voluminous convert)."
    yield "Options of a format: voluminous formats NAME. What a file is its content tells."


def _one(reader: Reader) -> Iterator[str]:
    yield f"{reader.name}: {_what(reader)}"
    yield f"  files: {_files(reader)}; {'read and written' if reader.writes else 'read'}"
    if needs := _needs(reader):
        yield f"  needs: {needs}"
        yield f"    {install_line(reader.extra)}" if reader.extra else ""
    for title, options in (
        ("options (--set KEY=VALUE, voluminous.open)", reader.options),
        ("options for writing (volume.save)", reader.write_options),
    ):
        yield from ("", f"{title}:") if options else ()
        width = max(map(len, options), default=0)
        for name, line in options.items():
            indent = " " * (width + 4)
            yield textwrap.fill(f"  {name:{width}}  {line}", _WIDTH, subsequent_indent=indent)


def _what(reader: Reader) -> str:
    foreign = "" if type(reader).__module__.startswith("voluminous.") else " (from another package)"
    return reader.description + foreign


def _files(reader: Reader, most: int | None = None) -> str:
    if not reader.suffixes:
        return "by content"
    return " ".join(reader.suffixes[:most]) + " …" * (len(reader.suffixes) > (most or 99))


def _needs(reader: Reader) -> str:
    if not reader.packages:
        return ""
    missing = [name for name in reader.packages if not is_installed(name)]
    state = f"{', '.join(missing)} not installed" if missing else "installed"
    return f"{', '.join(reader.packages)} ({state})"
