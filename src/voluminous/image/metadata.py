"""The metadata of an image as one JSON text that every format can store."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from ..errors import FileFormatError
from .arguments import PLANES, Array
from .cube import Cube

if TYPE_CHECKING:
    from .image import Image

# Name of the entry in a file's header, and the key that identifies our JSON text.
KEY = "voluminous"
VERSION = 1


def dumps(image: Image, *, coordinates: bool = True) -> str:
    """Return an ASCII text with units, camera, provenance and, optionally, pixel coordinates."""
    entries: dict[str, Any] = {
        KEY: VERSION,
        "unit": image.unit,
        "intensity_unit": image.intensity_unit,
        "pixel_size": image.pixel_size,
        "distance": image.distance,
        "camera": image.camera,
        "provenance": image.provenance,
    }
    if coordinates:
        # Python's decimal representation of floats restores the same bits.
        entries |= {"x": image.x.tolist(), "y": image.y.tolist()}
    if isinstance(image, Cube):
        entries["spectral"] = image.spectral.describe()
        if not coordinates:
            del entries["spectral"]["values"]
    if image.wcs is not None:
        entries["wcs"] = str(image.wcs.to_header_string(relax=True))
    return json.dumps(entries)


def oriented(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a volume's `meta` says of how a patient lies in it; nothing if that is unknown.

    ``orientation`` has the letters of +x, +y and +z, ``direction`` how the cells are turned.
    """
    known = isinstance(meta.get("orientation"), str)
    return {key: meta[key] for key in ("orientation", "direction") if known and key in meta}


def planes(image: Image) -> Iterator[tuple[str, Array]]:
    """Yield the arrays of an image beside its intensities, with their names.

    The optical depth of a cube is left out where it is still to be drawn: that may take as long,
    and as much memory, as the cube itself.
    """
    for name in PLANES:
        waits = name == "optical_depth" and isinstance(image, Cube) and image.waits_for_depth
        plane = None if waits else image.plane(name)
        if plane is not None:
            yield name, plane


def fits_text(text: str) -> str:
    """Return JSON without quotes and ampersands, which are special in the strings of FITS."""
    return text.replace("'", "\\u0027").replace("&", "\\u0026")


def texts(image: Image) -> dict[str, str]:
    """Return the texts that a PNG carries, by keyword."""
    return {"Software": KEY, KEY: dumps(image)}


def loads(text: str | None, shape: tuple[int, ...]) -> dict[str, Any]:
    """Parse the text of `dumps` into keyword arguments of `Image`; {} for any other text.

    Coordinates are dropped if they do not match `shape` (ny, nx): another program may have cropped
    the picture without changing the text.
    """
    if not text or not text.startswith(f'{{"{KEY}":'):
        return {}
    try:
        entries = json.loads(text)
    except ValueError as error:
        raise FileFormatError(f"the description of the image is damaged: {error}") from error
    if entries.pop(KEY) != VERSION:
        raise FileFormatError(
            "the description of the image was written by a newer voluminous; install that version"
        )
    if "x" in entries and (len(entries["y"]), len(entries["x"])) != tuple(shape[:2]):
        for name in ("x", "y", "unit", "pixel_size", "wcs"):
            entries.pop(name, None)
    places = (entries.get("spectral") or {}).get("values", ())
    if len(places) not in (0, *shape[2:]):
        del entries["spectral"]
    return dict(entries)
