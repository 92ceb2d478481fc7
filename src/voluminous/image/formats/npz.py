"""NumPy archives: everything, bit for bit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from .. import metadata
from ..arguments import PLANES, gathered
from .contract import Format

if TYPE_CHECKING:
    from ..image import Image

_AXES = ("x", "y")


def write(image: Image, path: Path) -> None:
    """Write all arrays uncompressed: compression takes time and hardly shrinks intensities."""
    arrays: dict[str, Any] = {"intensity": image.intensity, "x": image.x, "y": image.y}
    for name in PLANES:
        plane = getattr(image, name)
        if plane is not None:
            arrays[name] = gathered(plane)
    text = metadata.dumps(image, coordinates=False)
    with open(path, "wb") as file:
        np.savez(file, metadata=np.array(text), **arrays)


def read(path: Path) -> dict[str, Any]:
    """Read an archive with an array named `intensity` and, if present, our other arrays."""
    # NumPy does not close a file that it has opened itself and that is not an archive.
    with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
        if "intensity" not in archive:
            found = ", ".join(archive.files) or "nothing"
            raise FileFormatError(f"expected an array named intensity; the file holds {found}")
        image = {"intensity": archive["intensity"]}
        image |= {name: archive[name] for name in (*PLANES, *_AXES) if name in archive}
        text = str(archive["metadata"]) if "metadata" in archive else None
    return image | metadata.loads(text, image["intensity"].shape)


FORMAT = Format("a NumPy archive (.npz)", (".npz",), (b"PK",), write, read)
