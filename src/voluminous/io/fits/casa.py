"""Reader for CASA images (directories of tables): python-casacore exports them to FITS."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...packages import require
from ..contract import FieldChoice, FieldInfo, Reader
from ..hdf5 import first_bytes
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
            text = first_bytes(path / _TOLD, 200) if (path / _TABLE).is_file() else b""
        except OSError:
            return False
        return b"Type = Image" in text

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        with _exported(path) as file:
            return FITSReader().read(file, fields, **options).load()  # the file is temporary

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        with _exported(path) as file:
            return FITSReader().info(file, **options)


@contextmanager
def _exported(path: Path) -> Iterator[Path]:
    images = require(
        "casacore.images", "casa", "reading a CASA image (its exportfits makes it a FITS file)"
    )
    with tempfile.TemporaryDirectory(prefix="voluminous-") as folder:
        images.image(str(path.resolve())).tofits(f"{folder}/image.fits", velocity=False)
        yield Path(folder, "image.fits")
