"""What `voluminous info` tells of a scene."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any


def describe_scene(path: Path) -> Iterator[str]:
    """Yield lines about a scene; its volume is not read."""
    from ..scene import Scene
    from ..scene.toml import inline

    scene = Scene.load(path)
    settings = scene.to_dict()
    yield f"{path}: a scene, all of it valid"
    for section, content in settings.items():
        for number, table in enumerate(content if isinstance(content, list) else [content], 1):
            yield ""
            yield f"{section} {number}" if isinstance(content, list) else section
            yield from _lines(table, inline)
    data = settings["volume"].get("path")
    if data is not None and not (scene.directory / data).exists():
        yield ""
        yield f"There is no file {scene.directory / data}: put it there, or change volume.path"
    yield ""
    yield f"Next: voluminous render {shlex.quote(str(path))}"


def _lines(table: Mapping[str, Any], inline: Any) -> Iterator[str]:
    width = max(map(len, table))
    for key, value in table.items():
        yield f"  {key:{width}}  {inline(value)}"
