"""Open the explorer: turn, slide, click and film a file with data or a scene, in a browser."""

from __future__ import annotations

import argparse
import glob
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from .common import say
from .data import common_name, is_series, is_volume
from .render import add_scene_arguments, scene_from

if TYPE_CHECKING:
    from ..viewer.explorer import Explorer
    from ..volume import Volume

# Seconds in which a browser comes, to be told why there is nothing to see.
_PATIENCE = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_scene_arguments(parser)
    help = (
        "open the files, or all that fit a PATTERN such as 'ts_*.npz', as steps of a series, each "
        "as the first one; files whose names and fields differ by a number only are one anyhow"
    )
    parser.add_argument("--over", metavar="PATTERN", nargs="?", const="", help=help)
    group = parser.add_argument_group("where it is served")
    help = "serve a unix socket that only you can open, for ssh -L, instead of a port"
    group.add_argument("--socket", action="store_true", help=help)
    group.add_argument("--port", type=int, default=0, help="default: any that is free")
    help = "a name under which a proxy serves this machine; may be given several times"
    group.add_argument("--allow-host", action="append", default=[], metavar="NAME", help=help)
    help = "the path under which a proxy serves the page, such as /volume/"
    group.add_argument("--base-path", default="/", metavar="PATH", help=help)
    group.add_argument("--no-browser", action="store_true", help="only print the address")


def _series(args: argparse.Namespace) -> list[Path]:
    """Return the files of a series, the first as the scene; none if there is no series."""
    files = [args.scene, *args.more]
    if args.over:
        files = [Path(name) for name in sorted(glob.glob(args.over))]
        if not files or args.more:
            raise InputError(
                f"there are no files {args.over}"
                if not files
                else "give a PATTERN after --over, or several files, not both"
            )
        # What is no step of the series says how its files are drawn: a scene.
        args.scene = args.scene if args.scene.suffix.lower() == ".toml" else files[0]
    elif args.over is None and not is_series(files, args.format):
        return []
    if len(files) > 1 and args.scene in files:
        names = common_name(files, args.format)
        args.set += [f"{key}={value}" for key, value in names.items()]
    say(args.quiet, f"a series of {len(files)} files: {files[0].name} … {files[-1].name}")
    return files


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C, or until no page has been open for an hour.

    The address stands before the file is opened, which takes as long as it is large.
    """
    from ..viewer.page import Server

    is_volume(args.scene, args.format)  # what nothing can read has no page
    proxy = {"hosts": args.allow_host, "base_path": args.base_path, "name": args.scene.name}
    server = Server(port=args.port, unix_socket=args.socket, **proxy)
    explorer: Explorer | None = None
    try:
        server.start()
        print(server.instructions(), flush=True)
        if with_browser := not (args.no_browser or server.needs_tunnel):
            server.open_browser()
        try:
            explorer = _opened(args)
        except Exception as error:
            server.refuse(error, _PATIENCE if with_browser else 0.0)
            raise
        server.show(explorer)
        server.wait()
    finally:
        server.close()
        if explorer is not None:
            explorer.close()
    return 0


def _opened(args: argparse.Namespace) -> Explorer:
    from ..viewer.explorer import Explorer

    files = _series(args)
    args.more = [] if files else args.more
    scene = scene_from(args, all_fields=True)

    def opened(file: Path) -> Volume:
        return scene.volume() if file == args.scene else scene.of_file(file)()

    return Explorer(files or scene.volume(), scene.medium, scene.camera, scene.to_dict(), opened)
