"""What `voluminous render` makes of a data file: a scene that shows something of any data."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import FileFormatError, InputError
from .info import is_image

if TYPE_CHECKING:
    from ..scene import Scene

_INCL, _PHI, _LEVELS, _PIXELS = 60.0, 30.0, 4, 800
# Options that belong to data files: a scene says all this itself.
_OPTIONS = ("field", "levels", "incl", "phi")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options for data files; all are None unless given."""
    group = parser.add_argument_group("data files", "what is chosen by itself for these")
    group.add_argument("--field", metavar="EXPR", help="field or expression to show")
    group.add_argument(
        "-n", "--levels", type=int, metavar="N", help=f"number of shells ({_LEVELS})"
    )
    group.add_argument("--incl", type=float, metavar="DEG", help=f"inclination ({_INCL:g})")
    group.add_argument("--phi", type=float, metavar="DEG", help=f"azimuth ({_PHI:g})")


def is_volume(path: Path) -> bool:
    """Return True for a file with data; False for a scene, or an image with one in it.

    Raises
    ------
    VoluminousError
        If there is no such file, or nothing can be made of it.
    """
    from ..io import find_reader

    if path.suffix.lower() == ".toml" or is_image(path):
        return False
    try:
        find_reader(path)
    except FileFormatError:
        if _is_text(path):  # a scene by another name
            return False
        raise
    return True


def _is_text(path: Path) -> bool:
    if not path.is_file():
        return False
    try:
        path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return False
    return path.stat().st_size > 0


def refuse_options(args: argparse.Namespace) -> None:
    """Refuse the options for data files beside a scene.

    Raises
    ------
    InputError
        If one was given.
    """
    given = [f"--{name}" for name in _OPTIONS if getattr(args, name) is not None]
    if given:
        raise InputError(
            f"{' and '.join(given)}: for data files only; change this scene with --set, such as "
            "--set camera.incl=40"
        )


def scene_of(args: argparse.Namespace) -> Scene:
    """Return the scene for a data file: automatic shells, seen obliquely, all of it in the frame.

    Raises
    ------
    VoluminousError
        If the file cannot be read, or the expression names something that is not there.
    """
    from ..calibration import auto
    from ..io import open as open_volume
    from ..scene import Scene

    path: Path = args.scene
    volume = open_volume(path)
    levels = _LEVELS if args.levels is None else args.levels
    medium = auto(volume, args.field, levels)
    source: dict[str, Any] = {"path": path.name}
    fields = [name for name in medium.names if name in volume]
    if fields:
        source["fields"] = fields
    camera = {
        "incl": _INCL if args.incl is None else args.incl,
        "phi": _PHI if args.phi is None else args.phi,
        "resolution": _PIXELS,
    }
    settings = {"volume": source, "medium": medium, "camera": camera}
    return Scene(settings, path.parent, volume=volume)
