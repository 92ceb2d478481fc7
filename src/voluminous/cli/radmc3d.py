"""Make RADMC-3D's images and spectra of a model, by its own words and files."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from ..radmc3d.words import request_of
from .common import add_quiet, check_directory, say

_FILES = {"image": "image.out", "tausurf": "image.out", "spectrum": "spectrum.out"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.epilog = (
        "Example: voluminous radmc3d image lambda 870 incl 60 phi 30 npix 400 sizeau 200. Options "
        "come before the words; the words are those of RADMC-3D's manual."
    )
    help = "folder of the model; by default the working directory"
    parser.add_argument("--model", type=Path, default=Path(), metavar="DIR", help=help)
    help = "file to write, also .fits and other formats; by default RADMC-3D's, in the folder"
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help=help)
    help = "double (default), as RADMC-3D, or single"
    parser.add_argument("--precision", default="double", help=help)
    add_quiet(parser)
    help = "image, spectrum, sed or tausurf, and what follows it in RADMC-3D"
    parser.add_argument("words", nargs=argparse.REMAINDER, metavar="WORD", help=help)


def run(args: argparse.Namespace) -> int:
    """Draw what the words ask for, and write RADMC-3D's file."""
    from ..progress import progress_bar
    from ..radmc3d.session import Session

    request = request_of(args.words)
    session = Session.of(request, args.model)
    name = _FILES[request.command]
    path = args.output or args.model / (name.replace(".out", ".bout") if session.binary else name)
    check_directory(path)
    start = time.perf_counter()
    with progress_bar(False if args.quiet else None, request.command) as progress:
        result = session.result(precision=args.precision, progress=progress)
    if path.suffix in (".out", ".bout"):
        session.write(result, path)
    else:
        result.save(path)
    size = "" if request.command == "spectrum" else f"{request.nx} x {request.ny} pixels, "
    count, seconds = len(session.frequencies), time.perf_counter() - start
    say(args.quiet, f"{path}: {size}{count} wavelength{'s' * (count > 1)}, {seconds:.2f} s")
    return 0
