"""Open the explorer: turn, slide, click and film a file with data or a scene, in a browser."""

from __future__ import annotations

import argparse

from .render import add_scene_arguments, scene_from


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_scene_arguments(parser)
    group = parser.add_argument_group("where it is served")
    help = "serve a unix socket that only you can open, for ssh -L, instead of a port"
    group.add_argument("--socket", action="store_true", help=help)
    group.add_argument("--port", type=int, default=0, help="default: any that is free")
    help = "a name under which a proxy serves this machine; may be given several times"
    group.add_argument("--allow-host", action="append", default=[], metavar="NAME", help=help)
    help = "the path under which a proxy serves the page, such as /volume/"
    group.add_argument("--base-path", default="/", metavar="PATH", help=help)
    group.add_argument("--no-browser", action="store_true", help="only print the address")


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C, or until no page has been open for an hour."""
    from ..viewer.explorer import Explorer
    from ..viewer.page import Server

    scene = scene_from(args, all_fields=True)
    explorer = Explorer(scene.volume(), scene.medium, scene.camera, scene.to_dict())
    proxy = {"hosts": args.allow_host, "base_path": args.base_path}
    server = Server(explorer, port=args.port, unix_socket=args.socket, **proxy)
    try:
        server.start()
        print(server.instructions(), flush=True)
        if not (args.no_browser or server.needs_tunnel):
            server.open_browser()
        server.wait()
    finally:
        server.close()
        explorer.close()
    return 0
