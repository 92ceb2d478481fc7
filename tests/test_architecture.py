"""What the package promises of itself: quick to import, documented, pure Python, one version."""

from __future__ import annotations

import ast
import importlib.metadata
import inspect
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import voluminous as vm
from voluminous.errors import unknown_name

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("astropy", "matplotlib", "h5py", "PIL", "tqdm", "tifffile", "OpenEXR", "scipy")

EVERY_MODULE = """
import importlib, pkgutil, voluminous
for found in pkgutil.walk_packages(voluminous.__path__, "voluminous."):
    if not found.name.endswith(("__main__", ".xarray")):
        importlib.import_module(found.name)
"""
HELP = """
import contextlib, io
from voluminous.cli import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main(["--help"])
"""


def loaded_by(script: str) -> set[str]:
    """Return the top-level modules that a new Python has after running a script."""
    tell = "\nimport json, sys; print(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    done = subprocess.run(
        [sys.executable, "-c", script + tell], capture_output=True, text=True, check=True
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize("script", ["import voluminous", HELP], ids=["import", "help"])
def test_importing_and_asking_for_help_load_nothing_heavy(script):
    loaded = loaded_by(script)
    assert "voluminous" in loaded
    assert not loaded & {*HEAVY, "drjit"}


@pytest.mark.parametrize("name", ["Volume", "Gaussian", "render", "view"])
def test_any_public_name_may_be_the_first(name):
    assert "drjit" in loaded_by(f"import voluminous; voluminous.{name}")


def test_no_module_loads_anything_heavy_before_it_is_used():
    # Dr.Jit is what kernels are written in: modules with kernels do import it.
    loaded = loaded_by(EVERY_MODULE)
    assert "drjit" in loaded
    assert not loaded & set(HEAVY)


def test_branches_of_schemes_and_media_can_be_differentiated():
    """In loops Dr.Jit loses derivatives of what its own branches use besides their arguments."""
    source = ROOT / "src/voluminous"
    rooms = ("schemes", "media", "spectral", "radmc3d")
    files = [path for room in rooms for path in (source / room).glob("*.py")]
    assert files
    assert not [path.name for path in files if "if_else" in path.read_text(encoding="utf-8")]


def test_loops_and_branches_of_kernels_raise_what_was_raised_in_them():
    """Those of Dr.Jit turn Ctrl-C into a RuntimeError."""
    sources = [*(ROOT / "src/voluminous").rglob("*.py"), *(ROOT / "examples").rglob("*.py")]
    raw = re.compile(r"dr\.(while_loop|if_stmt)\(")
    assert len(sources) > 100
    assert not [path for path in sources if raw.search(path.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("name", [n for n in vm.__all__ if n != "__version__"])
def test_public_names_are_documented(name):
    public = getattr(vm, name)
    assert inspect.getdoc(public)
    if inspect.isclass(public) and not issubclass(public, BaseException):
        own = {n: m for n, m in vars(public).items() if not n.startswith("_") and callable(m)}
        undocumented = [n for n in own if not inspect.getdoc(getattr(public, n))]
        assert not undocumented


def test_all_public_names_can_be_seen():
    assert sorted(vm.__all__) == dir(vm)
    assert len(set(vm.__all__)) == len(vm.__all__)


def test_an_unknown_name_names_the_nearest():
    with pytest.raises(AttributeError, match="did you mean 'Gaussian'"):
        vm.Gausian  # noqa: B018 - looking it up is the test


@pytest.mark.parametrize(
    ("kind", "several"),
    [
        ("key", "keys"),
        ("axis", "axes"),
        ("samples", "samples"),
        ("suffix", "suffixes"),
        ("stretch", "stretches"),
        ("density", "densities"),
        ("kind of table", "kinds of table"),
        ("format that can be written", "formats that can be written"),
        ("option for writing", "options for writing"),
    ],
)
def test_an_unknown_name_lists_the_others_in_the_plural(kind, several):
    assert f" known {several}: a, b" in str(unknown_name(kind, "?", ["b", "a"]))


def test_what_is_installed_is_pure_python():
    wheel = importlib.metadata.distribution("voluminous").read_text("WHEEL")
    assert "Root-Is-Purelib: true" in wheel
    assert re.findall(r"^Tag: (.*)$", wheel, re.MULTILINE) == ["py3-none-any"]


@pytest.mark.parametrize(
    ("file", "pattern"),
    [
        ("CITATION.cff", r'^version: "?([^"\n]*)"?$'),
        ("CHANGELOG.md", r"^## \[(\d[^\]]*)\]"),
    ],
)
def test_the_version_of_a_copy_without_history_is_the_same_everywhere(file, pattern):
    declared = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (fallback,) = re.findall(r'^fallback_version = "(.*)"', declared, re.MULTILINE)
    text = (ROOT / file).read_text(encoding="utf-8")
    assert re.findall(pattern, text, re.MULTILINE)[0] == fallback


def test_the_architecture_lists_all_rooms():
    declared = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    layers = re.search(r'id = "rooms".*?layers = \[(.*?)\]', declared, re.DOTALL)[1]
    table = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8").partition("| room |")[2]
    rooms = re.findall(r"^\| (`.*?`) \|", table.partition("| rule |")[0], re.MULTILINE)
    listed = re.findall(r"`(\w+)`", " ".join(rooms))
    assert ["__main__", *listed] == re.findall(r"\w+", layers)


def test_the_version_is_that_of_what_is_installed():
    assert vm.__version__ == importlib.metadata.version("voluminous")


# Media of spectra, and who observes them or reads their files; two that know shapes of one scalar.
KNOW_SPECTRA = ("spectral", "observing", "radmc3d")
KNOW_SHAPES = ("rendering/sources/wide_steps.py", "rendering/sources/channel_layout.py")


def classes_switched_on(path: Path) -> set[str]:
    """Return the names of classes in `isinstance`, `register` and `match` of a module."""
    found: list[ast.AST] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            called = getattr(node.func, "id", getattr(node.func, "attr", ""))
            arguments = {"isinstance": node.args[1:], "issubclass": node.args[1:]}
            found += arguments.get(called, node.args if called == "register" else [])
        elif isinstance(node, ast.MatchClass):
            found.append(node.cls)
    return {n.id for node in found for n in ast.walk(node) if isinstance(n, ast.Name)}


def test_no_module_switches_on_the_class_of_a_medium():
    """What others ask of a medium is a method of its class, so that a new one is one file."""
    from voluminous import media

    source = ROOT / "src/voluminous"
    names = {n for n in media.__all__ if inspect.isclass(getattr(media, n))} | {"Formulas"}
    names -= {"Medium", "Context"}
    assert {"Gaussian", "Sum", "Shaped", "ColorBy"} <= names
    found = {}
    for path in source.rglob("*.py"):
        name = path.relative_to(source).as_posix()
        if not name.startswith(("media/", *(f"{room}/" for room in KNOW_SPECTRA))):
            found[name] = classes_switched_on(path) & names
    assert {name for name, switched in found.items() if switched} <= set(KNOW_SHAPES)
    assert not [path.name for path in source.rglob("*.py") if "singledispatch" in path.read_text()]


def test_no_module_gives_a_name_twice():
    """The second constant of a name would change what code above it reads."""
    for path in (ROOT / "src/voluminous").rglob("*.py"):
        names = []
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            targets = node.targets if isinstance(node, ast.Assign) else []
            targets += [node.target] if isinstance(node, ast.AnnAssign) else []
            parts = [part for target in targets for part in ast.walk(target)]
            names += [
                p.id for p in parts if isinstance(p, ast.Name) and isinstance(p.ctx, ast.Store)
            ]
        assert not {name for name in names if names.count(name) > 1}, path
