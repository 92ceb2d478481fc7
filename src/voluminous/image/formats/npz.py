"""NumPy archives: everything, bit for bit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from .. import metadata
from ..arguments import PLANES
from ..cube import Cube

if TYPE_CHECKING:
    from ..image import Image


def write(image: Image, path: Path) -> None:
    """Write all arrays uncompressed: compression takes time and hardly shrinks intensities."""
    arrays: dict[str, Any] = {"intensity": image.intensity, "x": image.x, "y": image.y}
    arrays |= dict(metadata.planes(image))
    if isinstance(image, Cube):
        arrays["spectral"] = image.spectral.values
    with open(path, "wb") as file:
        np.savez(file, metadata=np.array(metadata.dumps(image, coordinates=False)), **arrays)


def read(path: Path) -> dict[str, Any]:
    """Read an archive with an array named `intensity` and, if present, our other arrays."""
    # NumPy does not close a file that it has opened itself and that is not an archive.
    with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
        if "intensity" not in archive:
            held = ", ".join(archive.files) or "nothing"
            raise FileFormatError(f"expected an array named intensity; the file holds {held}")
        names = ("intensity", "x", "y", *PLANES)
        image = {name: archive[name] for name in names if name in archive}
        text = str(archive["metadata"]) if "metadata" in archive else None
        image |= metadata.loads(text, image["intensity"].shape)
        if "spectral" in image:
            image["spectral"] = {**image["spectral"], "values": archive["spectral"]}
    return image
