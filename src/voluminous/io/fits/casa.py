"""Reader for CASA images (directories of tables): python-casacore exports them to FITS."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...image.fits_header import as_fits, is_casa_image
from ..contract import FieldChoice, FieldInfo, Reader
from .reader import FITSReader

if TYPE_CHECKING:
    from ...volume import Volume


class CASAReader(Reader):
    """Images of CASA and casacore: ``.image``, ``.residual``, ``.psf`` …"""

    name = "casa"
    description = "a CASA image"
    suffixes = ()
    packages = ("casacore",)
    extra = "casa"
    options = FITSReader.options

    def matches(self, path: Path, head: bytes) -> bool:
        return is_casa_image(path)

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        with as_fits(path) as file:
            return FITSReader().read(file, fields, **options).load()  # the file is temporary

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        with as_fits(path) as file:
            return FITSReader().info(file, **options)
