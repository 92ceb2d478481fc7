"""What can be taken away from the explorer: pictures, the scene as a file, and as a script."""

from __future__ import annotations

import base64
import tempfile
from pathlib import Path
from typing import Any

from ..errors import check_name
from ..scene import Scene

# The file that scene and script of a volume in memory speak of.
IN_MEMORY = "volume.npz"
_PICTURES = {"png": "image/png", "exr": "image/x-exr", "fits": "application/fits"}


def exported(scene: Scene, what: str) -> dict[str, Any]:
    """Return name, kind and content of a file: text, or bytes in base64."""
    check_name("export", what, (*_PICTURES, "toml", "python"))
    if what == "toml":
        return {"name": "scene.toml", "mime": "application/toml", "text": scene.dumps()}
    if what == "python":
        return {"name": "scene.py", "mime": "text/x-python", "text": python_of(scene)}
    image = scene.render(progress=False)
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / f"picture.{what}"
        scene.save_image(image, path)
        data = base64.b64encode(path.read_bytes()).decode()
    return {"name": path.name, "mime": _PICTURES[what], "data": data}


def python_of(scene: Scene) -> str:
    """Return a script that makes the picture."""
    source = dict(scene.to_dict()["volume"])
    derived, units = source.pop("derived", {}), source.pop("units", {})
    model, path = source.pop("model", None), source.pop("path", IN_MEMORY)
    given = "".join(f", {key}={value!r}" for key, value in source.items())
    made = f"vm.open({path!r}{given})" if model is None else f"vm.models.{model}({given[2:]})"
    lines = [f"volume = {made}"]
    lines += [f"volume.set_unit({name!r}, {unit!r})" for name, unit in units.items()]
    lines += [f"volume[{name!r}] = {str(text)!r}" for name, text in derived.items()]
    media = [f"vm.{part!r}" for part in scene.medium.components()]
    joined = "\nmedium += ".join(media)
    options = "".join(f", {key}={value!r}" for key, value in scene.render_options.items())
    shown = "".join(f", {key}={value!r}" for key, value in scene.image_options.items())
    return (
        "import voluminous as vm\n\n" + "\n".join(lines) + f"\nmedium = {joined}\n"
        f"camera = vm.{scene.camera!r}\n"
        f"image = vm.render(volume, medium, camera{options})\n"
        f'image.save("picture.png"{shown})\n'
    )
