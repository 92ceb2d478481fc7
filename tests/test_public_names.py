"""Whatever is given for any argument of any public name, what comes is of this package's own."""

import importlib
import inspect

import numpy as np
import pytest
from astropy import units as u

import public_names
import voluminous as vm
from public_names import CALLS, SHELL

# Numbers, texts, sequences and things that are none of what is asked for.
STRANGE = (
    *(None, "", "abc", "1 m", b"x", np.nan, np.inf, -1, 0, 1j, 10**400, True, -0.5, 1e308),
    *([], [1, 2], [[1, 2], [3]], [None], ["red", 3], {}, (1, 2, 3, 4), range(3)),
    *(3 * u.m, np.array(None), np.array([1.0, np.nan]), object(), abs, SHELL, "x" * 300),
)
# Of processes, files, windows; what others are for (tests of movies, files, the explorer).
ELSEWHERE = {"progress", "executor", "path", "ax", "checkpoint", "directory"}


def parameters(call):
    """Return the names of what is taken, and of what must be given."""
    found = [
        p
        for p in inspect.signature(call).parameters.values()
        if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)
    ]
    return [p.name for p in found], [p.name for p in found if p.default is inspect.Parameter.empty]


def tried(name, strange):
    """Call with each of some strange things for each argument; return raw errors, by argument."""
    call, given = CALLS[name]
    taken, needed = parameters(call)
    raw = []
    for argument in taken:
        if argument in ELSEWHERE or argument.startswith("_"):
            continue
        for value in strange:
            others = {one: value for one in needed if one not in given}
            try:
                call(**{**others, **given, argument: value})
            except vm.VoluminousError as error:
                raw += [f"{name}({argument}): {error}"] if len(str(error)) > 3000 else []
            except Exception as error:
                raw.append(f"{name}({argument}={value!r:.40}): {type(error).__name__}: {error}")
    return raw


@pytest.mark.parametrize("name", sorted(CALLS))
@pytest.mark.filterwarnings("ignore")
def test_strange_arguments_are_taken_or_refused(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    call, given = CALLS[name]
    taken, needed = parameters(call)
    assert set(given) <= set(taken)
    if set(needed) <= set(given):
        call(**given)
    raw = tried(name, STRANGE)
    assert not raw, "\n".join(raw)


def test_no_public_name_is_forgotten():
    """A new name has its line in `public_names`."""
    known = {name.partition(".")[0] for name in CALLS} | public_names.UNTRIED
    assert known >= {name for name in vm.__all__ if callable(getattr(vm, name))}
    for module in ("regions", "movies"):
        found = importlib.import_module(f"voluminous.{module}")
        for name in getattr(found, "__all__", ()):
            assert f"{module}.{name}" in CALLS or name in known
