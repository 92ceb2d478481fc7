"""Progress of long work: a bar on a terminal and in a notebook, or a function of the caller."""

from __future__ import annotations

import functools
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar

from .errors import InputError, MemoryNeededError

Report = Callable[[int, int], None]
Progress = bool | Report | None
P = ParamSpec("P")
T = TypeVar("T")
# Work that is over before this many seconds needs no bar.
_DELAY = 2.0
# Where loops that know no caller report.
_current: ContextVar[Report | None] = ContextVar("report", default=None)


@contextmanager
def progress_bar(progress: Progress = None, label: str = "") -> Iterator[Report]:
    """Give a function of (done, total) that reports progress.

    Parameters
    ----------
    progress : bool, callable or None
        True draws a bar, False none; None draws one after two seconds, on a terminal and in a
        notebook. A function is called itself; it may raise to cancel.
    label : str
        What is going on.

    Examples
    --------
    >>> with progress_bar(True, "core") as report:
    ...     image = vm.render(volume, medium, camera, progress=report)
    """
    if not callable(progress) and progress not in (True, False, None):
        raise InputError(
            f"progress must be True, False, None or a function of done and total, got {progress!r}"
        )
    bar = None if callable(progress) else _Bar(label, progress)
    report: Any = progress if bar is None else bar.report
    token = _current.set(report)
    try:
        yield report
    finally:
        _current.reset(token)
        if bar is not None:
            bar.close()


def with_progress(function: Callable[P, T]) -> Callable[P, T]:
    """Make a function with an argument ``progress`` take all that `progress_bar` does.

    Where NumPy or Dr.Jit finds no memory that says `MemoryNeededError`.
    """

    @functools.wraps(function)
    def reporting(*args: P.args, **kwargs: P.kwargs) -> T:
        progress: Any = kwargs.get("progress")
        with progress_bar(progress, function.__name__) as report:
            kwargs["progress"] = report
            try:
                return function(*args, **kwargs)
            except MemoryError as error:
                if isinstance(error, MemoryNeededError):
                    raise
                raise MemoryNeededError(
                    f"{function.__name__} needs more memory than there is ({error}); draw less at "
                    "once, or with memory=, where it takes that"
                ) from error

    return reporting


def reported_range(
    size: int, step: int, before: int = 0, total: int | None = None
) -> Iterator[int]:
    """Yield from ``range(0, size, step)``, and report each step: of a part of a larger total."""
    report = reporter()
    for first in range(0, size, step):
        yield first
        report(before + min(first + step, size), size if total is None else total)


def reporter() -> Report:
    """Return the function that loops report to."""
    return _current.get() or silent


def silent(done: int, total: int) -> None:
    """Report nothing."""


class _Bar:
    """A bar of tqdm that appears when work lasts."""

    def __init__(self, label: str, wanted: bool | None) -> None:
        self.label, self.start = label, time.monotonic()
        self.bar: Any = None
        self.cell: Any = None
        self.shown = (_is_seen() if wanted is None else wanted) is True
        self.delay = 0.0 if wanted else _DELAY

    def report(self, done: int, total: int) -> None:
        if not self.shown or time.monotonic() - self.start < self.delay:
            return
        if self.bar is None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a notebook without widgets has bars of letters
                from tqdm.auto import tqdm
            options = {"desc": self.label, "total": total, "unit_scale": True, "leave": False}
            if "notebook" in tqdm.__mro__[1].__module__:
                from IPython import display

                show: Any = display.display  # untyped where there is IPython
                self.bar = tqdm(**options, display=False)
                self.cell = show(self.bar.container, display_id=True)
            else:
                self.bar = tqdm(**options)
            self.bar.start_t -= time.monotonic() - self.start
        if total != self.bar.total or done < self.bar.n:
            self.bar.total, self.bar.n = total, min(self.bar.n, done)
        self.bar.update(done - self.bar.n)

    def close(self) -> None:
        if self.bar is not None:
            self.bar.close()
        if self.cell is not None:
            self.cell.update({}, raw=True)  # nothing of it is left in a saved notebook


def in_jupyter() -> bool:
    """Return whether the code runs in a kernel of Jupyter."""
    shell: Any = sys.modules.get("IPython")
    shell = None if shell is None else shell.get_ipython()
    return shell is not None and "IPKernelApp" in shell.config


def _is_seen() -> bool:
    return in_jupyter() or sys.stderr.isatty()
