"""Work in other processes, on executors of other packages, and what is sent to them once."""

from __future__ import annotations

import hashlib
import pickle
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from dataclasses import dataclass
from typing import Any

from .errors import InputError, UnreachableError, VoluminousError

# Seconds between two reports: cancelling takes effect there.
_POLL = 0.2
# How often a task is tried again after errors of files, and how long after the first of them.
_AGAIN, _PAUSE = 3, 0.2
# What this process was sent last: its token, and what was made of it.
_kept: list[Any] = [None, None]


def as_executor(given: Any) -> Any:
    """Return the executor to submit to: that of a Dask client, or the given one.

    Raises
    ------
    InputError
        If it is neither.
    """
    if callable(getattr(given, "get_executor", None)):
        return given.get_executor(pure=False)
    if callable(getattr(given, "submit", None)) and not isinstance(given, type):
        return given
    raise InputError(
        "executor is a concurrent.futures.Executor, such as ProcessPoolExecutor(8) or mpi4py's "
        f"MPIPoolExecutor(), or a Dask client, got {given!r}"
    )


def run_tasks(
    executor: Any,
    begin: Callable[[int], tuple[Any, ...] | None],
    end: Callable[[int, Any], Any],
    names: Sequence[str],
    report: Callable[[], Any],
    before: Sequence[set[int]] | None = None,
) -> None:
    """Run tasks in other processes.

    Parameters
    ----------
    executor : Executor
        See `as_executor`. It stays open.
    begin : callable
        Returns, for the number of a task, a function of a module and its arguments; None if there
        is nothing left to do.
    end : callable
        Is given the number of a task and its result.
    names : sequence of str
        Of the tasks, for errors.
    report : callable
        Is called five times a second or more often; may raise to cancel.
    before : sequence of sets of int, optional
        Numbers of the tasks that must end before each begins. By default they are independent.

    Raises
    ------
    VoluminousError
        If a task fails, with its name; after errors of files (OSError) it is tried three times
        more. Tasks that have not begun are cancelled then.
    """
    waiting, left = list(range(len(names))), set(range(len(names)))
    tries = [_AGAIN] * len(names)
    pending: dict[Future[Any], int] = {}
    later: dict[int, float] = {}  # tasks to try again, and when
    try:
        while left:
            now = time.monotonic()
            ready = [k for k in waiting if before is None or not before[k] & left]
            waiting = [k for k in waiting if k not in set(ready)]
            ready += [k for k, when in later.items() if when <= now]
            for k in ready:
                later.pop(k, None)
                task = begin(k)
                if task is None:
                    end(k, None)
                    left.discard(k)
                else:
                    pending[_submit(executor, task, names[k])] = k
            if ready and before is not None:
                continue  # others may be ready now
            finished, _ = wait(pending, _POLL, FIRST_COMPLETED) if pending else ((), ())
            for future in sorted(finished, key=pending.__getitem__):
                k = pending.pop(future)
                error = _error(future)
                if error is None:
                    end(k, future.result())
                    left.discard(k)
                elif _is_passing(error) and tries[k] > 0:
                    tries[k] -= 1
                    later[k] = time.monotonic() + _PAUSE * 2 ** (_AGAIN - 1 - tries[k])
                else:
                    raise _named(error, names[k]) from error
            report()
            if not pending and later:
                time.sleep(_POLL)
    finally:
        for future in pending:
            future.cancel()


def _submit(executor: Any, task: tuple[Any, ...], name: str) -> Future[Any]:
    try:
        future: Future[Any] = executor.submit(*task)
    except Exception as error:
        raise _named(error, name) from error
    return future


def _error(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _is_passing(error: BaseException) -> bool:
    """Return whether the next try may succeed: the file system, not what the user gave."""
    explained = isinstance(error, VoluminousError)
    return isinstance(error, UnreachableError) or (isinstance(error, OSError) and not explained)


def _named(error: BaseException, name: str) -> BaseException:
    if isinstance(error, VoluminousError):
        return type(error)(f"{name}: {error}")
    if isinstance(error, BrokenExecutor):
        return VoluminousError(
            f"{name}: a process of the executor died, killed or of too little memory, and the "
            f"executor goes on no more ({error}); do the same again with a new one: finished "
            "frames are kept, and finished blocks with checkpoint=. Dask replaces processes that "
            "die"
        )
    if isinstance(error, CancelledError):
        return VoluminousError(f"{name}: cancelled, or the executor was closed")
    if not isinstance(error, Exception):
        return error
    return VoluminousError(f"{name}: {type(error).__name__}: {error}")


@dataclass(frozen=True)
class Sent:
    """What a function without arguments returns, in other processes, which call it once.

    Each keeps what it made last: tasks with the same one use it again.
    """

    token: str
    data: bytes

    @classmethod
    def of(cls, make: Callable[[], Any], what: str) -> Sent:
        """Return what can be sent.

        Raises
        ------
        InputError
            If it cannot be pickled; tells what it is.
        """
        try:
            data = pickle.dumps(make)
        except Exception as error:
            raise InputError(
                f"{what} cannot be sent to other processes ({type(error).__name__}: {error}); read "
                "its fields first, volume.load(), or save it as .zarr or .h5 and open that"
            ) from error
        return cls(hashlib.sha256(data).hexdigest(), data)

    def value(self) -> Any:
        """Return it, in the process that has it."""
        if _kept[0] != self.token:
            _kept[:] = None, None  # two of them may not fit
            _kept[:] = self.token, pickle.loads(self.data)()
        return _kept[1]
