"""Image files: `FORMATS` lists them, the suffix selects one."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import check_name
from ...files import check_start, expecting, replacing
from ..cube import Cube
from ..fits_header import as_fits, is_casa_image
from ..tone import OPTIONS, check_options
from . import exr, fits, npz, png, radmc3d, tiff

if TYPE_CHECKING:
    from ..image import Image


@dataclass(frozen=True)
class Format:
    """A file format for images. To add one, add it to `FORMATS`.

    `name` is for messages, with an article; `suffixes` are lower case, with the dot; `magic` are
    the possible first bytes of a file. ``write(image, path, *, options)`` writes a new file, which
    is removed again after an error; ``**display`` takes the options of `Image.to_rgb`.
    ``read(path)`` returns the keyword arguments of `Image`. It need not catch exceptions: the
    caller converts any of them to a `FileFormatError` that names the file.
    """

    name: str
    suffixes: tuple[str, ...]
    magic: tuple[bytes, ...]
    write: Callable[..., None]
    read: Callable[[Path], dict[str, Any]]

    @property
    def options(self) -> frozenset[str]:
        """Names of the options that `write` takes."""
        parameters = inspect.signature(self.write).parameters.values()
        shows = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters)
        accepted = {p.name for p in parameters if p.kind is p.KEYWORD_ONLY}
        return frozenset(accepted | OPTIONS if shows else accepted)


FORMATS = (
    Format("a PNG image", (".png",), (png.SIGNATURE,), png.write, png.read),
    Format(
        "a TIFF image",
        (".tif", ".tiff"),
        (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
        tiff.write,
        tiff.read,
    ),
    Format("an OpenEXR image", (".exr",), (b"v/1\x01",), exr.write, exr.read),
    Format(
        "a FITS image",
        (".fits", ".fit", ".fts"),
        (b"SIMPLE  =", b"\x1f\x8b"),
        fits.write,
        fits.read,
    ),
    Format("a NumPy archive (.npz)", (".npz",), (b"PK",), npz.write, npz.read),
    Format(
        "a RADMC-3D image (image.out)",
        (".out",),
        (b" ", b"\n", b"\r", b"\t", b"1", b"2", b"3", b"4"),
        radmc3d.write,
        radmc3d.read,
    ),
    Format(
        "a RADMC-3D image (image.bout)",
        (".bout",),
        tuple(bytes([number]) + bytes(7) for number in (1, 2, 3, 4)),
        radmc3d.write,
        radmc3d.read,
    ),
    Format("a JPEG image", (".jpg", ".jpeg"), (b"\xff\xd8\xff",), png.write_jpeg, png.read_jpeg),
    Format("a PDF file", (".pdf",), (b"%PDF",), png.write_page, png.read_page),
    Format("an SVG file", (".svg",), (b"<?xml", b"<svg"), png.write_page, png.read_page),
)


def format_of(path: Path) -> Format:
    """Return the format that belongs to the suffix of `path`."""
    known = {suffix: f for f in FORMATS for suffix in f.suffixes}
    suffix = path.suffix.lower()
    check_name("image format", suffix, known)
    return known[suffix]


def save(image: Image, path: Path, **options: Any) -> None:
    """Write `image` to `path` atomically; see `Image.save`."""
    form = format_of(path)
    check_options(f"{path.suffix} option", options, form.options)
    with replacing(path) as temporary:
        form.write(image, temporary, **options)


def load(path: Path, make: Callable[..., Image]) -> Image:
    """Read a file and pass its content to `make`, or to `Cube` if it has channels of a spectrum.

    A FITS file may be packed, by gzip or within (``.fits.gz``, ``.fits.fz``), or an image of CASA.
    """
    is_casa = is_casa_image(path)
    name = path.with_suffix("") if path.suffix.lower() in (".gz", ".fz") else path
    form = format_of(Path("image.fits") if is_casa else name)
    if not is_casa:
        check_start(path, form.magic, form.name)
    with expecting(path, form.name), as_fits(path) if is_casa else nullcontext(path) as file:
        content = form.read(file)
        return (Cube if content.get("spectral") else make)(**content)
