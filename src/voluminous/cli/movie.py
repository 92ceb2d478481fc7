"""Film a scene, or a file with data: an orbit, a zoom, keyframes, a series in time."""

from __future__ import annotations

import argparse
import glob
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from .common import check_directory, say
from .render import add_scene_arguments, scene_from

if TYPE_CHECKING:
    from ..cameras import Camera
    from ..scene import Scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_scene_arguments(parser)
    help = ".mp4, .gif or .webp; or a picture per frame: orbit.png writes orbit_0000.png and so on"
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help=help)
    group = parser.add_argument_group("path of the camera")
    help = "go around once, in so many frames"
    group.add_argument("--orbit", type=int, metavar="FRAMES", help=help)
    group.add_argument("--turns", type=float, default=1.0, help="of an orbit (1)")
    help = "show less and less: first width over last"
    group.add_argument("--zoom", type=float, metavar="FACTOR", help=help)
    help = "come closer: first distance over last"
    group.add_argument("--dolly", type=float, metavar="FACTOR", help=help)
    group.add_argument("--frames", type=int, default=240, help="of a zoom or dolly (240)")
    help = 'TOML file with a [[keyframe]] for each: frame = 0, camera.incl = 60 …; ease = "smooth"'
    group.add_argument("--keyframes", type=Path, metavar="FILE", help=help)
    help = 'files of a series in time, such as "out_*.athdf", in the order of their names'
    parser.add_argument("--over", metavar="PATTERN", help=help)
    parser.add_argument("--fps", type=float, default=30.0, help="frames per second (30)")
    help = "add a scale bar, axes and colour bars"
    parser.add_argument("--annotate", action="store_true", help=help)


def run(args: argparse.Namespace) -> int:
    """Render all frames that are missing, and write the film."""
    from ..movies import movie
    from ..progress import progress_bar

    check_directory(args.output)
    scene = scene_from(args)
    picture = dict(scene.image_options)
    if args.annotate:
        picture["annotate"] = {"medium": scene.medium}
    volumes: Any = scene.volume()
    if args.over is not None:
        volumes = sorted(glob.glob(args.over))
        if not volumes:
            raise InputError(f"there are no files {args.over}")
    options = {**scene.render_options, "objects": scene.objects}
    with progress_bar(False if args.quiet else None, args.output.name) as progress:
        paths = movie(
            volumes,
            scene.medium,
            cameras_of(args, scene),
            args.output,
            fps=args.fps,
            picture=picture,
            progress=progress,
            **options,
        )
    last = "" if len(paths) == 1 else f" … {paths[-1].name}"
    say(args.quiet, f"{paths[0]}{last}")
    return 0


def cameras_of(args: argparse.Namespace, scene: Scene) -> list[Camera]:
    """Return the path of the camera."""
    from ..cameras import Orthographic
    from ..movies import dolly, orbit, zoom

    given = {name: getattr(args, name) for name in ("orbit", "zoom", "dolly", "keyframes")}
    chosen = [name for name, value in given.items() if value is not None]
    if len(chosen) > 1:
        raise InputError(f"give one of --{' and --'.join(chosen)}; films can be joined in Python")
    if not chosen:
        if args.over is None:
            raise InputError("say what moves: --orbit, --zoom, --dolly, --keyframes or --over")
        return [scene.camera]
    if chosen == ["keyframes"]:
        return read_keyframes(args.keyframes, scene)
    if chosen == ["orbit"]:
        return orbit(scene.camera, args.turns, args.orbit)
    make = zoom if chosen == ["zoom"] else dolly
    camera = scene.camera
    if make is zoom and isinstance(camera, Orthographic) and camera.width is None:
        camera = camera.replace(width=camera.frame(scene.volume().grid).width)
    return make(camera, given[chosen[0]], args.frames)


def read_keyframes(path: Path, scene: Scene) -> list[Camera]:
    """Return the path through the cameras of a TOML file; each changes the scene's camera."""
    from ..io.guard import placed
    from ..movies import keyframes
    from ..scene.scene import text_of
    from ..scene.sections import build_camera
    from ..scene.settings import loads

    told = loads(text_of(path))
    with placed(path):
        unknown = set(told) - {"keyframe", "ease"}
        if unknown or not told.get("keyframe"):
            raise InputError('expected [[keyframe]] tables, and ease = "smooth"')
        own = scene.to_dict().get("camera", {})
        cameras = [build_camera({**own, **one.get("camera", {})}) for one in told["keyframe"]]
        frames = [one.get("frame", -1) for one in told["keyframe"]]
        return keyframes(list(zip(frames, cameras, strict=True)), told.get("ease", "smooth"))
