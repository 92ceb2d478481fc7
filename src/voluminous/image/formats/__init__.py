"""Image files: one format per module; `FORMATS` lists them, and the suffix selects one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import unknown_name
from ...files import check_start, expecting, replacing
from ..tone import check_options
from . import exr, fits, npz, pictures, png, radmc3d, tiff
from .contract import Format

if TYPE_CHECKING:
    from ..image import Image

FORMATS: tuple[Format, ...] = (
    png.FORMAT,
    tiff.FORMAT,
    exr.FORMAT,
    fits.FORMAT,
    npz.FORMAT,
    radmc3d.TEXT,
    radmc3d.BINARY,
    pictures.JPEG,
    pictures.PDF,
    pictures.SVG,
)


def format_of(path: Path) -> Format:
    """Return the format that belongs to the suffix of `path`."""
    known = {suffix: f for f in FORMATS for suffix in f.suffixes}
    suffix = path.suffix.lower()
    if suffix not in known:
        raise unknown_name("image format", suffix, known)
    return known[suffix]


def save(image: Image, path: Path, **options: Any) -> None:
    """Write `image` to `path` atomically; see `Image.save`."""
    form = format_of(path)
    check_options(f"{path.suffix} option", options, form.options)
    with replacing(path) as temporary:
        form.write(image, temporary, **options)


def load(path: Path, make: Callable[..., Image]) -> Image:
    """Read a file and pass its content to `make` (the class `Image`); see `Image.load`."""
    form = format_of(path)
    check_start(path, form.magic, form.name)
    with expecting(path, form.name):
        return make(**form.read(path))
