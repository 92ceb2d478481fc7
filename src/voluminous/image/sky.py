"""World coordinates (astropy WCS) of pixels that were turned, flipped or made anew."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import InputError


def of_pixels(wcs: Any, matrix: Any, origin: Any, shape: Any) -> Any:
    """Return the WCS of pixels q that lie at ``matrix q + origin`` among the pixels of another.

    Parameters
    ----------
    wcs : astropy.wcs.WCS
        Of n axes. It stays as it is.
    matrix : array_like, shape (n, n)
        Regular.
    origin : array_like, shape (n,)
        Where q = 0 is; the centre of the first pixel is 0.
    shape : sequence of n int
        Numbers of new pixels.

    Notes
    -----
    Only the linear part of the chain changes, from pixels to the plane of projection: Greisen &
    Calabretta (2002), "Representations of world coordinates in FITS", eq. 9.
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    new = wcs.deepcopy()
    linear = np.diag(wcs.wcs.get_cdelt()) @ wcs.wcs.get_pc() @ matrix
    # The size of a pixel along each world axis, with the sign it has along its own pixel axis.
    steps = np.linalg.norm(linear, axis=1) * np.where(np.diag(linear) < 0, -1.0, 1.0)
    if wcs.wcs.has_cd():
        del new.wcs.cd
    new.wcs.pc, new.wcs.cdelt = linear / steps[:, None], steps
    reference = np.linalg.solve(matrix, wcs.wcs.crpix - 1.0 - np.asarray(origin, np.float64))
    new.wcs.crpix = reference + 1.0
    new.pixel_shape = [int(n) for n in shape]
    new.wcs.set()
    return new


def as_wcs(value: Any, shape: tuple[int, ...]) -> Any:
    """Return the WCS of an image: an astropy WCS of two axes, or one as the text of a header.

    Parameters
    ----------
    value : astropy.wcs.WCS, str or None
        Of pixels, the centre of the lower left one being 0, 0.
    shape : tuple of int
        Rows and columns of the image.

    Raises
    ------
    InputError
        If it is something else, or has other axes.
    """
    if value is None:
        return None
    wcs = _from_text(value) if isinstance(value, str) else value
    if getattr(wcs, "pixel_n_dim", None) != 2 or not hasattr(wcs, "to_header"):
        raise InputError(f"wcs must be an astropy.wcs.WCS of two axes, got {value!r}")
    if wcs.pixel_shape is None:
        wcs.pixel_shape = (shape[1], shape[0])
    if tuple(wcs.pixel_shape) != (shape[1], shape[0]):
        raise InputError(
            f"wcs is for {wcs.pixel_shape[0]} x {wcs.pixel_shape[1]} pixels, the image has "
            f"{shape[1]} x {shape[0]}"
        )
    return wcs


def text_of(wcs: Any) -> str:
    """Return a WCS as the text of a FITS header."""
    return str(wcs.to_header_string(relax=True))


def tables_of(wcs: Any) -> dict[tuple[str, str], np.ndarray]:
    """Return the coordinates in a WCS's tables (``-TAB``), by the names of table and column."""
    texts = {(axis, m): text for axis, m, text in wcs.wcs.get_ps()}
    axes = [(int(table.map[0]) + 1, np.ravel(table.coord)) for table in wcs.wcs.tab]
    return {(texts[axis, 0], texts[axis, 1]): centers for axis, centers in axes}


def table_hdus(tables: Mapping[tuple[str, str], np.ndarray]) -> list[Any]:
    """Return what `tables_of` gives as HDUs."""
    from astropy.io import fits

    made = []
    for (name, title), values in tables.items():
        n = len(values)
        column = fits.Column(title, f"{n}D", dim=f"(1,{n})", array=np.reshape(values, (1, n, 1)))
        made.append(fits.BinTableHDU.from_columns([column], name=name))
    return made


def _from_text(text: str) -> Any:
    from astropy.io.fits import Header
    from astropy.wcs import WCS

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return WCS(Header.fromstring(text), relax=True)


def wcs_of_header(header: Any) -> Any:
    """Return the WCS of the first two axes of an image's header; None if it has none to speak of.

    Axes without a name, or called X and Y as ours are, are told by plain coordinates.
    """
    from astropy.wcs import WCS

    kinds = [str(header.get(f"CTYPE{n}", "")).strip() for n in (1, 2)]
    if not all(kinds) or kinds == ["X", "Y"]:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            wcs = WCS(header, naxis=2)
            wcs.wcs.set()
        except Exception:  # whatever is wrong with it, the picture can be read
            return None
    wcs.pixel_shape = (header["NAXIS1"], header["NAXIS2"])
    return wcs
