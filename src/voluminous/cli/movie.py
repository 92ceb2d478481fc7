"""Film a scene, or a file with data: an orbit, a zoom, keyframes, a series in time."""

from __future__ import annotations

import argparse
import glob
import os
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from .common import check_directory, say
from .render import add_scene_arguments, scene_from

if TYPE_CHECKING:
    from ..cameras import Camera
    from ..scene import Scene
    from ..volume import Volume


# Jobs of an array, if the user does not say how many.
_JOBS = 32
# A job that is started again, or sent again, draws what is missing.
_SCRIPT = """\
#!/bin/bash
#SBATCH --job-name={name}
#SBATCH --array=1-{jobs}
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=4
#SBATCH --mem=8G
#SBATCH --time=04:00:00
#SBATCH --requeue
#SBATCH --output={name}-%a.log
# Draws {frames} frames: job I of the array number I, I + {jobs}, …, but for those that are made.
# The job that finds all of them made is the last, and finishes. Whatever fails: send this again.
# Change times, memory and processors above as your data and your cluster need.
set -euo pipefail
cd {directory}
# Compiled kernels: on a disk of the node, not in a home that all nodes share.
export DRJIT_CACHE_DIR="${{TMPDIR:-/tmp}}/drjit-$UID"
exec {command} --share "$SLURM_ARRAY_TASK_ID/{jobs}"
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_scene_arguments(parser)
    help = (
        ".mp4, .gif or .webp; or a picture per frame: orbit.png writes orbit_0000.png and so on, "
        "frames/ a directory of them"
    )
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
    help = (
        'files of a series in time, such as "out_*.athdf", in the order of their names; opened as '
        "the scene's own, with its options and derived fields"
    )
    parser.add_argument("--over", metavar="PATTERN", help=help)
    parser.add_argument("--fps", type=float, default=30.0, help="frames per second (30)")
    help = "add a scale bar, axes and colour bars"
    parser.add_argument("--annotate", action="store_true", help=help)
    group = parser.add_argument_group("several programs side by side")
    help = "draw the I-th of N shares of the frames, as 2/8; the last to be ready makes the film"
    group.add_argument("--share", metavar="I/N", help=help)
    help = f"print a script for sbatch that draws N shares as an array of jobs ({_JOBS} at most)"
    group.add_argument("--slurm-array", type=int, nargs="?", const=0, metavar="N", help=help)


def run(args: argparse.Namespace) -> int:
    """Render all frames that are missing, and write the film."""
    from ..image.formats import format_of
    from ..movies import movie
    from ..movies.film import PICTURES
    from ..progress import progress_bar

    check_directory(args.output)
    if args.slurm_array is not None:
        args.quiet = True  # what is printed is the script
    scene = scene_from(args)
    known = format_of(args.output if args.output.suffix.lower() in PICTURES else Path("a.png"))
    picture = {k: v for k, v in scene.image_options.items() if k in known.options}
    if args.annotate:
        given = picture.get("annotate")
        noted = {} if scene.projection else {"medium": scene.medium}
        picture["annotate"] = {**noted, **(given if isinstance(given, dict) else {})}
    volumes = [scene.volume]
    if args.over is not None:
        volumes = [scene.of_file(path) for path in sorted(glob.glob(args.over))]
        if not volumes:
            raise InputError(f"there are no files {args.over}")
    cameras = cameras_of(args, scene, volumes[0])
    if args.slurm_array is not None:
        count = max(len(cameras), len(volumes))
        print(slurm_script(args, count), end="")
        return 0
    with progress_bar(False if args.quiet else None, args.output.name) as progress:
        paths = movie(
            volumes,
            scene.medium,
            cameras,
            args.output,
            fps=args.fps,
            picture=picture,
            project=scene.projection,
            share=None if args.share is None else share_of(args.share),
            progress=progress,
            **scene.drawing(),
        )
    last = "" if len(paths) == 1 else f" … {paths[-1].name}"
    say(args.quiet, f"{paths[0]}{last}")
    return 0


def share_of(text: str) -> tuple[int, int]:
    """Return the numbers of ``2/8``."""
    number, _, shares = text.partition("/")
    if not (number.isdecimal() and shares.isdecimal()):
        raise InputError(f"--share expects I/N such as 2/8, got {text!r}")
    return int(number), int(shares)


def slurm_script(args: argparse.Namespace, frames: int) -> str:
    """Return a script for sbatch that draws a film by the same command."""
    jobs = args.slurm_array or min(_JOBS, frames)
    if not 1 <= jobs <= frames:
        raise InputError(f"--slurm-array is from 1 to {frames}, the number of frames, got {jobs}")
    if args.share is not None:
        raise InputError("--slurm-array makes the shares; leave out --share")
    at = next(k for k, word in enumerate(args.argv) if word.startswith("--sl"))
    words, rest = args.argv[:at], args.argv[at + 1 :]
    if "=" not in args.argv[at] and args.slurm_array:
        rest = rest[1:]
    return _SCRIPT.format(
        name="".join(c if c.isalnum() else "-" for c in args.output.stem) or "film",
        jobs=jobs,
        frames=frames,
        directory=shlex.quote(os.getcwd()),
        command=shlex.join([sys.executable, "-m", "voluminous", *words, *rest]),
    )


def cameras_of(args: argparse.Namespace, scene: Scene, first: Callable[[], Volume]) -> list[Camera]:
    """Return the path of the camera; an open width is that of the first volume."""
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
        camera = camera.replace(width=camera.frame(first().grid).width)
    return make(camera, given[chosen[0]], args.frames)


def read_keyframes(path: Path, scene: Scene) -> list[Camera]:
    """Return the path through the cameras of a TOML file; each changes the scene's camera."""
    from ..io.guard import placed
    from ..movies import keyframes
    from ..scene.scene import text_of
    from ..scene.sections import build_camera
    from ..scene.settings import loads

    table = loads(text_of(path))
    with placed(path):
        unknown = set(table) - {"keyframe", "ease"}
        if unknown or not table.get("keyframe"):
            raise InputError('expected [[keyframe]] tables, and ease = "smooth"')
        shared = scene.to_dict().get("camera", {})
        cameras = [build_camera({**shared, **one.get("camera", {})}) for one in table["keyframe"]]
        frames = [one.get("frame", -1) for one in table["keyframe"]]
        return keyframes(list(zip(frames, cameras, strict=True)), table.get("ease", "smooth"))
