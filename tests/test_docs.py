"""The documentation is true: its code runs, its scenes and commands work, its links lead somewhere.

Blocks of a page share one namespace and one empty directory, in order:

* ``python`` is run, ``pycon`` is run and its output compared (as doctest does);
* ``toml`` that starts with a comment ``# name.toml`` is written to that file, and must be a scene;
* ``console``: lines ``$ voluminous …`` are run, and must succeed.

Other languages (``text``, ``sh`` …) are left alone.
"""

from __future__ import annotations

import doctest
import importlib
import pkgutil
import re
import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from PIL import Image as Pillow

import voluminous as vm
from voluminous.cli import main

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for path in (*ROOT.glob("*.md"), *(ROOT / "docs").glob("**/*.md"))
    if "_build" not in path.parts
)
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(
    r"\]\(([^)#\s]+)[^)]*\)|^```\{(?:include|figure|image)\} (\S+)"
    r"|^\[[^\]]+\]: (\S+)|<img src=\"([^\"]+)\"",
    re.MULTILINE,
)
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@dataclass
class Block:
    """A block of code in a page, and the line where its text starts."""

    page: str
    language: str
    text: str
    line: int


def blocks(page: str) -> Iterator[Block]:
    text = (ROOT / page).read_text(encoding="utf-8")
    for match in BLOCK.finditer(text):
        yield Block(page, match[1], match[2], text.count("\n", 0, match.start(2)) + 1)


def run_python(block: Block, names: dict[str, Any]) -> None:
    # Empty lines in front: a traceback then shows the line in the page.
    code = compile("\n" * (block.line - 1) + block.text, str(ROOT / block.page), "exec")
    exec(code, names)


def run_doctest(block: Block, names: dict[str, Any]) -> None:
    test = doctest.DocTestParser().get_doctest(block.text, names, block.page, None, block.line)
    test.globs = names  # the parser made a copy; what is assigned must stay
    told: list[str] = []
    doctest.DocTestRunner(optionflags=OPTIONS).run(test, out=told.append, clear_globs=False)
    assert not told, "".join(told)


def save_scene(block: Block, names: dict[str, Any]) -> None:
    name = re.match(r"# (\S+\.toml)\n", block.text)
    if name is not None:
        Path(name[1]).write_text(block.text, encoding="utf-8")
        vm.Scene.load(name[1])


def run_commands(block: Block, names: dict[str, Any]) -> None:
    for command in re.findall(r"^\$ voluminous (.*)$", block.text, re.MULTILINE):
        assert main(shlex.split(command, comments=True)) == 0, command


RUNNERS: dict[str, Callable[[Block, dict[str, Any]], None]] = {
    "python": run_python,
    "pycon": run_doctest,
    "toml": save_scene,
    "console": run_commands,
}


@pytest.mark.parametrize(
    "page", [p for p in PAGES if any(b.language in RUNNERS for b in blocks(p))]
)
def test_code_in_the_documentation_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "__main__"}
    for block in blocks(page):
        if block.language in RUNNERS:
            RUNNERS[block.language](block, names)


@pytest.mark.parametrize("page", PAGES)
def test_links_to_files_lead_somewhere(page):
    targets = ["".join(each) for each in LINK.findall((ROOT / page).read_text(encoding="utf-8"))]
    files = [t for t in targets if not re.match(r"https?:|mailto:", t)]
    missing = [t for t in files if not ((ROOT / page).parent / t).exists()]
    assert not missing


WIDTH = 100  # characters
# What is not wrapped: code, formulas, tables, pictures, HTML, targets of links.
UNWRAPPED = re.compile(
    r"^ *(```|~~~).*?^ *\1|^\$\$.*?\$\$$|^ *(?:\||!\[|<|\[[^\]]+\]:|    )[^\n]*$", re.M | re.S
)


@pytest.mark.parametrize("page", PAGES)
def test_prose_is_wrapped(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    prose = UNWRAPPED.sub(lambda block: "\n" * block[0].count("\n"), text).split("\n")
    assert not [number for number, line in enumerate(prose, 1) if len(line) > WIDTH]


def test_the_readme_starts_with_the_two_commands_and_the_ten_lines_work():
    found = [b for b in blocks("README.md") if b.language in ("sh", "python")]
    first, second = found[0].text.splitlines()
    venv = "python3 -m venv .venv && .venv/bin/pip install"
    assert first.split("  ")[0] == f"{venv} . && .venv/bin/voluminous demo"
    assert second.split("  ")[0] == f'{venv} ".[test]" && .venv/bin/pytest'
    assert found[1].language == "python"
    assert len(found[1].text.splitlines()) <= 10


# Pictures of large data sets take a minute together; their readers have tests of their own.
LARGE = {f"data_{name}" for name in ("collapse", "outflow", "hii", "disc", "galaxies", "frog")}
STATIC = ROOT / "docs" / "_static"
FIGURES = sorted(
    path.name for path in (*STATIC.glob("*.png"), *STATIC.glob("*.webp")) if path.stem not in LARGE
)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", FIGURES)
def test_the_pictures_can_be_made(name, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs")
    figures = importlib.import_module("figures")
    try:
        figures.FIGURES[Path(name).stem](tmp_path / name, pixels=32)
    except FileNotFoundError as missing:
        pytest.skip(str(missing))  # real data
    with Pillow.open(tmp_path / name) as picture:
        assert min(picture.size) > 100
    assert (STATIC / name).stat().st_size < 200_000


def test_the_api_lists_all_public_names():
    text = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    tasks = re.findall(r"^\| \[.*?\| (.*?) \|", text, re.MULTILINE)
    listed = re.findall(r"`(\w+)`", " ".join(tasks))
    assert sorted(listed) == sorted(set(vm.__all__) - {"__version__"})
    described = re.findall(r":: voluminous\.(?:\w+\.)*(\w+)$", text, re.MULTILINE)
    assert set(listed) - {"io", "measuring"} <= {*described, *dir(vm.errors)}


def modules() -> list[str]:
    found = pkgutil.walk_packages(vm.__path__, "voluminous.")
    return [m.name for m in found if not m.name.endswith("__main__")]


@pytest.fixture
def things(tmp_path, monkeypatch):
    """Put what examples in docstrings speak of into a directory and a namespace."""
    monkeypatch.chdir(tmp_path)
    with h5py.File("snapshot.h5", "w") as file:
        file["gas/rho"] = np.ones((4, 4, 4), dtype=np.float32)
    return {
        "np": np,
        "vm": vm,
        "volume": vm.models.sphere(8),
        "medium": vm.Coefficients("inside", "inside"),
        "camera": vm.Orthographic(resolution=8),
    }


def test_examples_in_docstrings_are_true(things):
    finder = doctest.DocTestFinder(exclude_empty=True)
    runner = doctest.DocTestRunner(optionflags=OPTIONS)
    for name in modules():
        module = importlib.import_module(name)
        for test in finder.find(module, extraglobs=things):
            runner.run(test)
    assert runner.summarize(verbose=False).failed == 0
    assert runner.tries > 0
