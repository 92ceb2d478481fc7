"""Picture of "Annotations and maps"."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from astropy import units as u
from drawing import compressed
from figures_media import outflow_walls
from PIL import Image as Pillow

import voluminous as vm


def annotated(target: Path, pixels: int) -> None:
    """An outflow on black with what its medium shows, and its column on white, on the sky."""
    walls = outflow_walls(max(16, pixels // 2))
    volume = vm.Volume(vm.CartesianGrid.uniform(walls.grid.shape, (-5e3, 5e3), unit="au"))
    volume["density"] = walls.array("density") * 1e-18 * u.g / u.cm**3
    volume["temperature"] = walls.array("temperature") * u.K
    volume.meta |= {"time": 12.0, "time_unit": "kyr"}
    camera = vm.Orthographic(70, 25, resolution=max(100, pixels))
    warmth = vm.ColorBy("temperature", "plasma", 10 * u.K, 3000 * u.K, norm="log")
    shell = vm.Isosurface("density", 5e-19 * u.g / u.cm**3, warmth, 0.3)
    picture = vm.render(volume, shell, camera)
    left = picture.annotate(volume=volume, title="An outflow")
    seen = vm.column(volume, "density", camera).on_sky(distance=140 * u.pc, position=(68.0, 18.1))
    right = seen.annotate(colormap="magma_r", paper="white", ticks=True, title="Its column")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / target.name
        sheets = [Pillow.fromarray(sheet.rgba[::-1]).convert("RGB") for sheet in (left, right)]
        _beside(sheets).save(path)
        compressed(path, target)


def _beside(sheets: list[Pillow.Image]) -> Pillow.Image:
    """Return pictures side by side, in the middle of the height of the highest."""
    gap = 20
    size = (sum(s.width for s in sheets) + gap, max(s.height for s in sheets))
    whole, x = Pillow.new("RGB", size, "white"), 0
    for sheet in sheets:
        whole.paste(sheet, (x, (size[1] - sheet.height) // 2))
        x += sheet.width + gap
    return whole


IMAGE_FIGURES: dict[str, Callable[[Path, int], None]] = {"annotated": annotated}
