"""Tell what is in a file: a scene, a volume or an image."""

from __future__ import annotations

import argparse
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
    is_scene = args.file.suffix.lower() == ".toml"
    of_data = args.format is not None or not (is_scene or is_image(args.file))
    from .info_text import describe_image, describe_scene, describe_volume

    if of_data:
        lines = describe_volume(data_file(args.file, args), bars=not args.no_histogram)
    else:
        given = {"--fields": args.fields, "--set": args.set, "--no-histogram": args.no_histogram}
        if wrong := [name for name, value in given.items() if value]:
            raise InputError(f"{' and '.join(wrong)}: for data files only")
        lines = (describe_scene if is_scene else describe_image)(args.file)
    for line in lines:
        print(line, flush=True)
    return 0
