"""What all tests share: how Hypothesis runs, and how compiled kernels are counted."""

from __future__ import annotations

import gc
import importlib.metadata
import signal
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import settings

pytest.register_assert_rewrite("contracts")

# A shell lets its background jobs ignore Ctrl-C, and their children inherit that: tests send it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The first example of a kind compiles a kernel: time per example says nothing. Examples are the
# same each time, so that a run tells of the code alone; `--hypothesis-profile search` looks for
# new ones.
settings.register_profile("voluminous", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None)
settings.load_profile("voluminous")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep a diagonal of the products of tests that say so, each value once; all if exhaustive."""
    products: dict[str, list] = {}
    for item in items:
        if item.get_closest_marker("each_value_once") is not None and hasattr(item, "callspec"):
            products.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for cases in products.values():
        numbers: dict[str, dict[int, int]] = {}
        for case in cases:
            for name, value in case.callspec.params.items():
                axis = numbers.setdefault(name, {})
                axis.setdefault(id(value), len(axis))
        longest = max(numbers, key=lambda name: len(numbers[name]))

        def places(case: Any, numbers: Any = numbers) -> dict[str, int]:
            return {name: numbers[name][id(v)] for name, v in case.callspec.params.items()}

        def off_diagonal(case: Any, numbers: Any = numbers, longest: str = longest) -> int:
            place = places(case)
            return sum(k != place[longest] % len(numbers[name]) for name, k in place.items())

        seen: set[tuple[str, int]] = set()
        for case in sorted(cases, key=off_diagonal):
            if seen >= places(case).items():
                case.add_marker(pytest.mark.exhaustive)
            seen |= places(case).items()


@pytest.fixture
def kernels() -> Callable:
    """Return a function that calls another and returns the hashes of the kernels it launched."""
    from voluminous.backend import dr

    def launched(function: Callable, *args, **options) -> set[str]:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            function(*args, **options)
            history = dr.kernel_history()
        return {entry["hash"] for entry in history if entry["type"] == dr.KernelType.JIT}

    return launched


@pytest.fixture
def entry_points(monkeypatch: pytest.MonkeyPatch) -> Iterator[list]:
    """Let the entry points of other packages be those of a list."""
    from voluminous.io import registry

    listed: list = []
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: listed)
    registry._foreign.cache_clear()
    yield listed
    registry._foreign.cache_clear()


@pytest.fixture
def no_collector() -> Iterator[None]:
    """Keep Python's garbage collector away: what goes, goes because nothing refers to it."""
    gc.disable()
    yield
    gc.enable()
