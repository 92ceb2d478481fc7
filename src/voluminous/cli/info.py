"""Tell what is in a file: a scene, a volume or an image."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("file", type=Path, help="scene (.toml), volume file or image file")


def run(args: argparse.Namespace) -> int:
    """Print what there is to know, and what to type next."""
    for line in describer(args.file)(args.file):
        print(line)
    return 0


def describer(path: Path) -> Callable[[Path], Iterator[str]]:
    """Return the function that tells of a file, by its suffix and, where that is open, content."""
    if path.suffix.lower() == ".toml":
        from .info_scene import describe_scene

        return describe_scene
    if is_image(path):
        from .info_image import describe_image

        return describe_image
    from .info_volume import describe_volume

    return describe_volume


def is_image(path: Path) -> bool:
    """Return True for an image file; content decides where the suffix leaves it open."""
    from ..image.formats import FORMATS

    if path.suffix.lower() == ".npz" and path.is_file():
        from ..io.arrays.npz import holds_image

        return holds_image(path)
    return any(path.suffix.lower() in form.suffixes for form in FORMATS)
