"""Draw the thin shell of "Which scheme?" with VTK, for `figures_schemes.py` to show.

python docs/vtk_shell.py

VTK is needed for this alone, so its pictures are kept: intensities over the source function, in the
8 bits that VTK gives.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image as Pillow

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent / "benchmarks"))

import scenes  # noqa: E402
import vtk_scene  # noqa: E402

PIXELS = 300
# Samples per cell's width.
SAMPLES = (1, 10)
# The shell of `figures_schemes.thin_shell`; its brightest channel alone.
SCENE = scenes.Scene(
    "shell",
    colors=((1.0, 1.0, 1.0),),
    opacity=0.2,
    centers=(3.7,),
    sigmas=(0.01,),
    path_length=6.67e15,
    frame=0.17,
    cells=64,
)


def drawn(samples: int) -> np.ndarray:
    """Return the intensity (ny, nx), from 0 to the source function, as 0 to 1."""
    vtk_scene.PIXELS = PIXELS
    scene = vtk_scene.VtkScene(SCENE, linear=True)
    scene.mapper.SetSampleDistance(scene._cell() / samples)
    scene.draw()
    return scene.picture()[..., 0] / scene.gain


def main() -> None:
    for samples in SAMPLES:
        target = DOCS / "_static" / "peers" / f"vtk_shell_{samples}.png"
        grey = np.rint(255 * drawn(samples)[::-1]).astype(np.uint8)
        Pillow.fromarray(grey).save(target, optimize=True)
        print(target)


if __name__ == "__main__":
    main()
