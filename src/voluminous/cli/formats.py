"""List the formats of data files, or the options of one."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..errors import unknown_name
from ..packages import install_line

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
    if args.name is None:
        print(*_table(sorted(known.values(), key=lambda r: r.name.lower())), sep="\n")
    elif args.name in known:
        print(*_one(known[args.name]), sep="\n")
    else:
        raise unknown_name("format", args.name, known)
    return 0


def _table(readers: list[Reader]) -> Iterator[str]:
    rows = [("format", "", "files", "needs", "what it is")]
    rows += [(r.name, _modes(r), _files(r, _MOST), _needs(r), _what(r)) for r in readers]
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
    yield from _options("options (--set KEY=VALUE, voluminous.open)", reader.options)
    yield from _options("options for writing (volume.save)", reader.write_options)


def _options(title: str, options: dict[str, str]) -> Iterator[str]:
    if not options:
        return
    yield ""
    yield f"{title}:"
    width = max(map(len, options))
    for name, line in options.items():
        indent = " " * (width + 4)
        yield textwrap.fill(f"  {name:{width}}  {line}", _WIDTH, subsequent_indent=indent)


def _what(reader: Reader) -> str:
    foreign = "" if type(reader).__module__.startswith("voluminous.") else " (from another package)"
    return reader.description + foreign


def _modes(reader: Reader) -> str:
    return "rw" if reader.writes else "r"


def _files(reader: Reader, most: int | None = None) -> str:
    if reader.writes_directory or not reader.suffixes:
        return "by content"
    return " ".join(reader.suffixes[:most]) + " …" * (len(reader.suffixes) > (most or 99))


def _needs(reader: Reader) -> str:
    from ..packages import is_installed

    packages = reader.packages
    if not packages:
        return ""
    missing = [name for name in packages if not is_installed(name)]
    state = "installed" if not missing else f"{', '.join(missing)} not installed"
    return f"{', '.join(packages)} ({state})"
