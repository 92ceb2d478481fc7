"""The command ``voluminous``: one module per subcommand, each with `add_arguments` and `run`.

Heavy modules are imported only when a command runs, so that ``--help`` is fast.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any

from ..errors import VoluminousError
from ..packages import version
from . import (
    convert,
    demo,
    doctor,
    formats,
    info,
    measure,
    movie,
    plan,
    probe,
    radmc3d,
    render,
    view,
)

COMMANDS: dict[str, ModuleType] = {
    module.__name__.rpartition(".")[2]: module
    for module in (
        demo,
        render,
        view,
        movie,
        plan,
        radmc3d,
        info,
        measure,
        probe,
        convert,
        formats,
        doctor,
    )
}

FAILED, INTERRUPTED = 2, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    0 on success, 1 if `doctor` reports a problem, 2 after an error, 130 after Ctrl-C; a SystemExit
    with 128 and the signal's number after SIGTERM or SIGHUP, as shells tell it.
    """
    for stream in (sys.stdout, sys.stderr):
        # A terminal that lacks a character shows a question mark instead of failing.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    args = parser().parse_args(argv)
    args.argv = list(sys.argv[1:] if argv is None else argv)
    try:
        with _plain_warnings(), _ended_by_signals():
            code = int(COMMANDS[args.command].run(args))
        print(end="", flush=True)
        return code
    except KeyboardInterrupt:
        print("voluminous: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of the output (head, less) has closed the pipe: stay silent, also on exit.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except (VoluminousError, OSError, MemoryError) as error:
        if args.traceback:
            raise
        print(f"voluminous: error: {str(error) or type(error).__name__}", file=sys.stderr)
        return FAILED


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    def end(number: int, frame: Any) -> None:
        raise SystemExit(128 + number)

    names = [name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    usual = [
        n for n in map(signal.Signals.__getitem__, names) if signal.getsignal(n) == signal.SIG_DFL
    ]
    if threading.current_thread() is not threading.main_thread():
        usual = []  # others cannot receive signals; nohup ignores SIGHUP
    for number in usual:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in usual:
            signal.signal(number, signal.SIG_DFL)


@contextlib.contextmanager
def _plain_warnings() -> Iterator[None]:
    before = warnings.formatwarning
    warnings.formatwarning = lambda message, *_, **__: f"voluminous: warning: {message}\n"
    try:
        yield
    finally:
        warnings.formatwarning = before


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    top = argparse.ArgumentParser(
        prog="voluminous",
        description="Physically based volume rendering: pictures from 3-D data.",
        epilog="Start with: voluminous demo",
    )
    top.add_argument("--version", action="version", version=f"voluminous {version()}")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, module in COMMANDS.items():
        summary = (module.__doc__ or "").splitlines()[0]
        sub = commands.add_parser(name, help=summary, description=summary)
        module.add_arguments(sub)
        sub.add_argument(
            "--traceback", action="store_true", help="show where in the program an error happened"
        )
    return top
