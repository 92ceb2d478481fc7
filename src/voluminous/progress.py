"""A progress bar on a terminal, and silence everywhere else."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Report = Callable[[int, int], None]
# What is over before this many seconds needs no bar.
_DELAY = 0.5


@contextmanager
def progress_bar(label: str = "", *, show: bool | None = None) -> Iterator[Report | None]:
    """Give a function for ``render(..., progress=...)`` that draws a bar with the time left.

    Parameters
    ----------
    label : str
        What is going on.
    show : bool, optional
        By default, if the error stream is a terminal. If not shown, None is given.

    Examples
    --------
    >>> with progress_bar("core") as progress:
    ...     image = vm.render(volume, medium, camera, progress=progress)
    """
    if not (sys.stderr.isatty() if show is None else show):
        yield None
        return
    from tqdm import tqdm

    with tqdm(desc=label, total=1, unit="ray", unit_scale=True, leave=False, delay=_DELAY) as bar:

        def report(done: int, total: int) -> None:
            if total != bar.total:
                bar.reset(total)
            bar.update(done - bar.n)

        yield report
