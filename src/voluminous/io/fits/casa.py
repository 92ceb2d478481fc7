"""Reader for CASA images (directories of tables): python-casacore exports them to FITS."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...packages import require
from ..contract import FieldChoice, FieldInfo, Reader
from .reader import FITSReader

if TYPE_CHECKING:
    from ...volume import Volume

_TABLE, _TOLD = "table.dat", "table.info"


class CASAReader(Reader):
    """Images of CASA and casacore: ``.image``, ``.residual``, ``.psf`` …"""

    name = "casa"
    description = "a CASA image"
    suffixes = ()
    packages = ("casacore",)
    extra = "casa"
    options = FITSReader.options

    def matches(self, path: Path, head: bytes) -> bool:
        try:
            text = (path / _TOLD).read_bytes()[:200] if (path / _TABLE).is_file() else b""
        except OSError:
            return False
        return b"Type = Image" in text

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        exported = _exported(path)
        volume = FITSReader().read(Path(exported.name) / "image.fits", fields, **options)
        volume.load()  # the file is temporary
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        return FITSReader().info(Path(_exported(path).name) / "image.fits", **options)


def _exported(path: Path) -> Any:
    """Return a temporary directory with the image as FITS; it is deleted with the object."""
    images = require(
        "casacore.images", "casa", "reading a CASA image (its exportfits makes it a FITS file)"
    )
    changed = max(part.stat().st_mtime_ns for part in path.rglob("*"))
    return _export(images, str(path.resolve()), changed)


@functools.lru_cache(maxsize=1)
def _export(images: Any, path: str, changed: int) -> Any:
    folder = tempfile.TemporaryDirectory(prefix="voluminous-")
    images.image(path).tofits(f"{folder.name}/image.fits", velocity=False)
    return folder
