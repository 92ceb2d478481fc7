"""How large the house is. Changes may lower these numbers, and may not raise them.

Who wants to add lines, members or files to the core takes others out.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import voluminous as vm
from voluminous.rendering import tracer

SOURCE = Path(vm.__file__).parent
# What a reader of the renderer owns: what happens between `render` and a number.
CORE = (
    *("backend", "expressions", "grids", "derivatives", "media", "schemes", "cameras", "rendering"),
    *("deferred.py", "errors.py", "evaluation.py", "fields.py", "geometry.py", "levels.py"),
    *("store.py", "units.py", "value.py", "volume.py"),
)
LINES = {"src": 81_700, "core": 31_275}
FILES = {"src": 391, "core": 139}
# Public members of the contracts.
MEMBERS = {
    "media/contract.py:Medium": 7,
    "media/bound.py:BoundMedium": 10,
    "grids/contract.py:Grid": 16,
    "grids/contract.py:Walk": 6,
    "schemes/base.py:Scheme": 7,
    "schemes/base.py:Source": 3,
    "schemes/base.py:CellSource": 1,
    "schemes/base.py:VertexSource": 1,
    "schemes/base.py:FieldSource": 3,
    "schemes/base.py:Fields": 5,
}
# Constants and private names of the package that tests replace.
PATCHED = 0
# Files entered by the second picture of a uniform grid, and by its ray loop alone.
ENTERED = {"picture": 82, "loop": 24}
LOOP_LINES = 6_000
# What knows units, volumes or files has no place in the ray loop.
NOT_IN_THE_LOOP = {
    *("deferred.py", "evaluation.py", "fields.py", "units.py", "volume.py"),
    *("expressions/units.py", "media/arguments.py"),
}


def files(rooms: tuple[str, ...]) -> Iterator[Path]:
    """Yield the Python files of rooms."""
    for room in rooms:
        path = SOURCE / room
        yield from path.rglob("*.py") if path.is_dir() else [path] if path.exists() else []


@pytest.mark.parametrize(("name", "rooms"), [("src", ("",)), ("core", CORE)])
def test_lines_and_files(name, rooms):
    paths = list(files(rooms))
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)
    assert lines <= LINES[name]
    assert len(paths) <= FILES[name]


@pytest.mark.parametrize("contract", MEMBERS)
def test_members_of_contracts(contract):
    path, _, name = contract.partition(":")
    tree = ast.parse((SOURCE / path).read_text(encoding="utf-8"))
    (body,) = (n.body for n in tree.body if isinstance(n, ast.ClassDef) and n.name == name)
    for node in [node for node in body if isinstance(node, ast.If)]:
        body += node.body  # what only type checkers see
    found = {node.name for node in body if isinstance(node, ast.FunctionDef)}
    for node in body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        found |= {target.id for target in targets if isinstance(target, ast.Name)}
    assert len([member for member in found if not member.startswith("_")]) <= MEMBERS[contract]


def test_few_private_names_are_patched():
    """Constants are arguments where tests need others, or data are large enough."""
    owner = r'(?:f?"voluminous[\w.{}]*\.|[\w.]+, "|[\w.]*\._\w+, ")'
    patched = re.compile(rf'setattr\(\s*{owner}(_\w+|[A-Z][A-Z_]+)"')
    found = [
        f"{path.name}: {name}"
        for path in sorted(Path(__file__).parent.rglob("test_*.py"))
        for name in patched.findall(path.read_text(encoding="utf-8"))
    ]
    assert len(found) <= PATCHED, found


def files_entered(call: Callable[[], Any]) -> set[str]:
    """Return which files of the package a call enters."""
    entered = set()

    def note(frame: Any, event: str, _: Any) -> None:
        if event == "call":
            entered.add(frame.f_code.co_filename)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(before)
    paths = (Path(name) for name in entered)
    return {str(p.relative_to(SOURCE)) for p in paths if p.is_relative_to(SOURCE)}


def test_few_files_are_entered_by_a_picture(monkeypatch):
    volume = vm.Volume(vm.CartesianGrid.uniform(32, (-1, 1)))
    volume["density"] = "10**(3 - 4 * (x**2 + y**2 + z**2))"
    # A tolerance of its own: the loop is traced, not taken from kernels of an earlier test.
    medium = vm.Gaussian("log10(density)", 2.0, 0.1, (0.9, 0.5, 0.1), 0.3, 0.1)
    camera = vm.Orthographic(60, 30, width=2.0, resolution=32)
    vm.render(volume, medium, camera)
    picture = files_entered(lambda: vm.render(volume, medium, camera, tolerance=1.1e-3))

    loop: set[str] = set()
    march = tracer.march
    volume = vm.Volume(vm.CartesianGrid.uniform(32, (-1, 1)))
    volume["density"] = "10**(3 - 4 * (x**2 + y**2 + z**2))"

    def noted(*args: Any, **options: Any) -> Any:
        result = []
        loop.update(files_entered(lambda: result.append(march(*args, **options))))
        return result[0]

    monkeypatch.setattr(tracer, "march", noted)
    vm.render(volume, medium, camera)
    assert loop, "the ray loop was not traced"
    assert len(picture) <= ENTERED["picture"], sorted(picture)
    assert len(loop) <= ENTERED["loop"], sorted(loop)
    lines = sum(len((SOURCE / name).read_text(encoding="utf-8").splitlines()) for name in loop)
    assert lines <= LOOP_LINES
    assert not loop & NOT_IN_THE_LOOP


def test_one_renderer():
    """Nobody asks whether a volume is in memory: each is a partition, of one block or of many."""
    kinds = "VolumeView|CartesianChunks|TreeParts|BlockTracer"
    asks = re.compile(rf"job\.pieces|\bOutline\b|isinstance\(.*({kinds})\)")
    sources = {path: path.read_text(encoding="utf-8") for path in SOURCE.rglob("*.py")}
    asked = {str(path.relative_to(SOURCE)) for path, text in sources.items() if asks.search(text)}
    assert not asked
