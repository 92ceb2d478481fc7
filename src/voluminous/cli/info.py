"""Tell what is in a file: a scene, a volume or an image."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from ..errors import InputError
from .data import add_fields_option, add_reading_options, data_file, is_image


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("file", type=Path, help="scene (.toml), volume file or image file")
    group = parser.add_argument_group("data files")
    add_fields_option(group, "fields to tell of; all that are read by default")
    add_reading_options(group)
    group.add_argument("--no-histogram", action="store_true", help="tell of ranges only")


def run(args: argparse.Namespace) -> int:
    """Print a description of the file, and commands to try next."""
    for line in lines(args):
        print(line, flush=True)
    return 0


def lines(args: argparse.Namespace) -> Iterator[str]:
    """Return the lines about a file; name and content decide: scene, image or volume."""
    path: Path = args.file
    is_scene = path.suffix.lower() == ".toml"
    if args.format is None and (is_scene or is_image(path)):
        _refuse_options(args)
        from .info_text import describe_image, describe_scene

        return (describe_scene if is_scene else describe_image)(path)
    from .info_text import describe_volume

    return describe_volume(data_file(path, args), histogram=not args.no_histogram)


def _refuse_options(args: argparse.Namespace) -> None:
    given = {"--fields": args.fields, "--set": args.set, "--no-histogram": args.no_histogram}
    wrong = [name for name, value in given.items() if value]
    if wrong:
        raise InputError(f"{' and '.join(wrong)}: for data files only")
