"""Pictures of real data, made by the lines that the gallery shows (`gallery_data.md`).

The data are not part of the repository: see `CONTRIBUTING.md`.
"""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Callable
from pathlib import Path

from drawing import compressed

import voluminous as vm

PAGE = Path(__file__).with_name("gallery_data.md")
ROOT = Path(__file__).resolve().parents[1]
# Fewer pixels are no picture.
_LEAST = 101
_ENTRY = re.compile(r"<!-- figure: (\S+) (\S+) -->\s*```py\n(.*?)```", re.S)


def data_folder() -> Path:
    """Return where the data sets are looked for."""
    return Path(os.environ.get("VOLUMINOUS_TEST_DATA", ROOT.parent / "shared")).resolve() / "data"


def drawn(folder: str, code: str, target: Path, pixels: int) -> None:
    """Run the lines of an entry beside its data, and save the picture they make.

    Raises
    ------
    FileNotFoundError
        If the data are not there.
    """
    found, before = data_folder() / folder, Path.cwd()
    if not found.is_dir():
        raise FileNotFoundError(f"no {found}; set VOLUMINOUS_TEST_DATA")
    names: dict[str, object] = {"vm": vm}
    os.chdir(found)
    try:
        exec(re.sub(r"resolution=\d+", f"resolution={max(pixels, _LEAST)}", code), names)
    finally:
        os.chdir(before)
    image = names["image"]
    assert isinstance(image, vm.Image)
    image.save(target)
    compressed(target, target)


DATA_FIGURES: dict[str, Callable[[Path, int], None]] = {
    name: functools.partial(drawn, folder, code)
    for name, folder, code in _ENTRY.findall(PAGE.read_text())
}
