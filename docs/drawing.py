"""How the pictures of the documentation are written."""

from __future__ import annotations

import tempfile
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image as Pillow

DPI = 120


def compressed(path: Path, target: Path, colors: int | None = 256) -> None:
    """Write a PNG with few colours, dithered: half the bytes, and rarely a difference to be seen.

    Shells of many colours over one another show it; None keeps all.
    """
    picture = Pillow.open(path).convert("RGB")
    if colors is not None:
        palette = picture.quantize(colors, method=Pillow.Quantize.MEDIANCUT, kmeans=2)
        picture = picture.quantize(palette=palette, dither=Pillow.Dither.FLOYDSTEINBERG)
    picture.save(target, optimize=True)


def saved(figure: Figure, target: Path, dpi: int = DPI, colors: int | None = 256) -> None:
    """Write a figure as a compressed PNG."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / target.name
        figure.savefig(path, dpi=dpi)
        compressed(path, target, colors)
