"""The spectral axis of a cube in FITS files, as radio astronomy software reads it.

Greisen et al. (2006), "Representations of spectral coordinates in FITS", A&A 446, 747: CTYPE3 is
VRAD, FREQ or WAVE, with RESTFRQ and SPECSYS. Uneven channels are a table, as SKIRT writes it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FileFormatError
from .spectral_axis import LIGHT_MICRON, UNITS, SpectralAxis

if TYPE_CHECKING:
    from astropy.io.fits import HDUList, Header
    from astropy.wcs import WCS


Card = tuple[str, Any, str]
Linear = tuple[str, str, float, float]  # type, unit, first value and step

# Kind → type of the axis, its unit, and that of `SpectralAxis.places` in it.
_TYPES = {
    "velocity": ("VRAD", "m/s", 1e3),
    "frequency": ("FREQ", "Hz", 1.0),
    "wavelength": ("WAVE", "m", 1e-6),
}
# What other types than these become, if not velocities.
_BECOMES = {"AWAV": "WAVE", "ENER": "FREQ", "WAVN": "FREQ", "AFRQ": "FREQ"}
# Types whose convention does not show without a frequency at rest.
_VELOCITIES = ("VOPT", "VELO")
# Extension with the places of uneven channels, in SKIRT's files and ours.
_TABLE, _COLUMN = "Z-axis coordinate values", "GRID_POINTS"
# Extension with the exact numbers: cards have 16 digits, and even steps only.
_EXACT = "SPECTRAL"
# Steps between header and exact numbers, at most, unless the header was edited.
_SAME = 1e-6
# Width that a file says of a single channel, as a part of its place, and of velocities in m/s.
_SINGLE, _SINGLE_VELOCITY = 1e-5, 1e3


def linear(axis: SpectralAxis) -> Linear:
    """Return an axis of even channels as a header has it."""
    kind, unit, factor = _TYPES[axis.kind]
    values = factor * axis.places(axis.kind)
    step = _SINGLE_VELOCITY if axis.kind == "velocity" else _SINGLE * values[0]
    if len(values) > 1:
        step = (values[-1] - values[0]) / (len(values) - 1)
    return kind, unit, float(values[0]), float(step)


def cards(axis: SpectralAxis) -> Iterator[Card]:
    """Yield the cards of the third axis."""
    kind, unit, first, step = linear(axis) if axis.is_even else ("CHANNEL", "", 0.0, 1.0)
    yield "CTYPE3", kind, "linear" if unit else "their places are in a table"
    yield "CRPIX3", 1.0, "reference pixel; centre of the first is 1"
    yield "CRVAL3", first, "coordinate there"
    yield "CDELT3", step, "from one channel to the next"
    if unit:
        yield "CUNIT3", unit, "unit"
    if axis.rest is not None:
        yield "RESTFRQ", axis.rest, "[Hz] frequency at rest"
    if axis.frame:
        yield "SPECSYS", axis.frame, "frame of velocities"
    if axis.line:
        yield "LINE", axis.line, "name of the line"


def hdus(axis: SpectralAxis) -> Iterator[Any]:
    """Yield the extensions: exact numbers, and the table of uneven channels."""
    from astropy.io import fits

    yield fits.ImageHDU(axis.values, name=_EXACT)
    if not axis.is_even:
        unit, values = UNITS[axis.kind].replace(" ", ""), axis.places(axis.kind)
        column = fits.Column(_COLUMN, "D", unit=unit.replace("micron", "um"), array=values)
        yield fits.BinTableHDU.from_columns([column], name=_TABLE)


def read(
    header: Header, hdus: HDUList, count: int, known: dict[str, Any] | None, wcs: WCS | None
) -> SpectralAxis | None:
    """Return the axis of so many channels; None if there is none.

    `known` are arguments that our own description has, `wcs` is that of the channels' axis. The
    exact numbers are valid unless the header was edited afterwards.
    """
    exact = next((np.array(h.data, np.float64) for h in hdus if h.name == _EXACT), None)
    axis = None if wcs is None or wcs.wcs.spec < 0 else _of_wcs(wcs, count)
    rest = header.get("RESTFRQ", header.get("RESTFREQ"))
    if not rest and header.get("RESTWAV"):
        rest = LIGHT_MICRON / (1e6 * header["RESTWAV"])
    if known and exact is not None and len(exact) == count:
        spectral = SpectralAxis(exact, **known)
        edited = spectral.rest is None or not np.isclose(
            rest or 0.0, spectral.rest, rtol=1e-12, atol=0.0
        )
        spectral = spectral.at_rest(rest) if rest and edited else spectral
        if not spectral.is_even or axis is None or _agree(spectral, axis):
            return spectral
    if axis is None or wcs is None:
        return None
    line, frame = str(header.get("LINE", "")), str(header.get("SPECSYS", "")) or wcs.wcs.specsys
    return axis.replace(rest=rest or None, line=line or None, frame=frame)


def _of_wcs(wcs: WCS, count: int) -> SpectralAxis:
    """Return what the WCS of a single axis describes, without what is at rest.

    Other kinds of axes become ours, by the formulas of wcslib.
    """
    from astropy.wcs import WCS

    places = np.arange(count, dtype=float)
    values = wcs.wcs_pix2world(places[:, None], 0)[:, 0]
    kinds = {kind: name for name, (kind, *_) in _TYPES.items()}
    if not (wcs.wcs.restfrq or wcs.wcs.restwav):
        kinds |= dict.fromkeys(_VELOCITIES, "velocity")  # of no known frequency
    name = wcs.wcs.ctype[0][:4]
    if name not in kinds:
        step = values[0] or 1.0  # an even axis: wcslib knows no logarithms or tables of others
        even = WCS(naxis=1)
        even.wcs.ctype, even.wcs.cunit = [name], wcs.wcs.cunit
        even.wcs.crpix, even.wcs.crval, even.wcs.cdelt = [1.0], values[:1], [step]
        even.wcs.restfrq, even.wcs.restwav = wcs.wcs.restfrq, wcs.wcs.restwav
        try:
            even.wcs.sptr(f"{_BECOMES.get(name, 'VRAD')}-???")
        except ValueError as error:
            raise FileFormatError(
                f"the axis {name} is no velocity without a frequency at rest; give its header "
                "RESTFRQ, in Hz"
            ) from error
        values = even.wcs_pix2world((values - values[0])[:, None] / step, 0)[:, 0]
        wcs, name = even, even.wcs.ctype[0][:4]
    unit = UNITS[kinds[name]]
    # 15 digits make a factor of 1000.0000000000001 one of 1000.
    return SpectralAxis(values * float(f"{wcs.wcs.cunit[0].to(unit):.15g}"), unit)


def _agree(one: SpectralAxis, other: SpectralAxis) -> bool:
    if one.kind != other.kind:
        return False
    values, seen = one.places(one.kind), other.places(one.kind)
    step = abs(linear(one)[3]) / _TYPES[one.kind][2]
    return bool(np.abs(values - seen).max() <= _SAME * step + 1e-14 * np.abs(values).max())
