"""Totals: mass, momentum and energy of all cells, or of a part of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..cameras import Camera
from ..errors import InputError, UnknownNameError, unknown_name
from ..notebook import page, table
from ..progress import Progress, reported_range, with_progress
from ..regions import Region
from ..units import parse_unit
from .cells import CHUNK, CellParts
from .columns import as_map, check_exact, exact_maps
from .quantity import CellQuantity, check_volume, column_unit, total_unit
from .shapes import Aperture, region_of

if TYPE_CHECKING:
    from ..image import Image
    from ..volume import Volume

# What people ask for by the name of the total, and what adds up to it.
_TOTALS = {
    "mass": "density",
    "momentum": "density * los('velocity')",
    "energy": "0.5 * density * norm('velocity')**2",
    "kinetic_energy": "0.5 * density * norm('velocity')**2",
}


@dataclass(frozen=True)
class Measurement(Mapping[str, Any]):
    """Totals by name: numbers, or Quantities where they have a unit.

    Attributes
    ----------
    totals : dict
        ∫ q dV of all quantities, over what is measured.
    volume : float or Quantity
        How much space that is.
    cells : int
        In how many cells, at least in part.
    missing : dict of str to int
        In how many of these cells a quantity has no value: they count nothing.
    maps : dict of str to Image
        Columns ∫ q ds per pixel, if asked for.
    """

    totals: dict[str, Any]
    volume: Volume
    cells: int
    missing: dict[str, int] = field(default_factory=dict)
    maps: dict[str, Image] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Any:
        return self.totals[name]

    def __iter__(self) -> Any:
        return iter(self.totals)

    def __len__(self) -> int:
        return len(self.totals)

    def __str__(self) -> str:
        width = max(map(len, self.totals))
        lines = [f"{name:{width}}  {value:.8g}" for name, value in self.totals.items()]
        return "\n".join([*lines, f"in {self.cells} cells, volume {self.volume:.6g}"])

    def _repr_html_(self) -> str:
        rows = [(name, f"{value:.8g}") for name, value in self.totals.items()]
        rows += [("volume", f"{self.volume:.6g}"), ("cells", str(self.cells))]
        rows += [(f"cells without {name}", str(n)) for name, n in self.missing.items() if n]
        return page("Measurement", table(rows))


@with_progress
def measure(
    volume: Volume,
    quantities: Any = None,
    where: Any = None,
    camera: Camera | Sequence[Camera] | None = None,
    *,
    region: Region | str | None = None,
    aperture: Any = None,
    maps: bool = False,
    samples: int = 4,
    device: str = "auto",
    progress: Progress = None,
) -> Any:
    """Return totals over cells, ∫ q dV = Σ q V: the mass of a density, the energy of its density.

    Parameters
    ----------
    volume : Volume
        Grid and fields; a quantity is constant in a cell.
    quantities : str, list of str or dict of str
        What to add up: one expression, several, or name → expression: ``{"mass": "density",
        "momentum": "density * los('velocity')"}``. Left out, the error says what there is.
    where : str, optional
        A condition that cells must fulfil, such as ``"los('velocity') > 5 km/s"``; numbers may have
        units on the right of a comparison.
    camera : camera or sequence of cameras, optional
        From where it is seen: for ``los(...)``, `aperture` and `maps`. Of several, the totals
        become a table with one row for each.
    region : Region or str, optional
        A part of space, see `voluminous.regions`; or a text such as ``"sphere((0, 0, 0), 100 AU)"``
        with ``box(low, high)``, ``cylinder(start, end, radius)``, ``cone`` and ``doublecone(apex,
        axis, opening, height)``, combined by ``&``, ``|`` and ``~``. Of a cell on its surface that
        part counts which has the centres of ``samples**3`` parts of the cell inside, or of more
        where it goes far around the axis.
    aperture : array_like or str, optional
        A part of the image: a polygon, shape (n, 2), in the image plane's coordinates (numbers in
        the volume's unit, or a Quantity), or a text: ``"circle(center, radius)"``,
        ``"rectangle(low, high)"``, ``"polygon(point, point, …)"``; or what counts of each pixel,
        shape (ny, nx), from 0 to 1 or true and false. Exact but for the pixels that
        a polygon cuts, which count in part.
    maps : bool
        Return columns per pixel too: exact ones, whose sum times a pixel's area is the total, as
        far as it is in the frame. `camera` must be orthographic, and cells boxes.
    samples : int
        See `region`.
    device : str
        For maps.
    progress
        As for `render`.

    Returns
    -------
    Measurement or astropy.table.QTable
        The table has the columns ``incl``, ``phi``, the quantities, ``volume`` and ``cells``.

    Raises
    ------
    InputError
        If something does not fit; UnitsError for units, UnknownNameError for names.

    Notes
    -----
    Peters, *The physics of volume rendering*, section 6, measures mass, momentum and kinetic energy
    of an outflow as optical depths; here they follow from the cells themselves, without rays.
    """
    check_volume(volume)
    asked = _asked(quantities, volume)
    if isinstance(region, str):
        region = region_of(region)
    if region is not None and not isinstance(region, Region):
        raise InputError(f"region must be one of vm.regions, got {type(region).__name__}")
    if camera is not None and not isinstance(camera, Camera):
        options = {"region": region, "aperture": aperture, "maps": maps}
        options |= {"samples": samples, "device": device, "progress": progress}
        return _table(volume, quantities, where, camera, options)
    volume.refresh()  # derivatives of fields that were changed in place
    seen = volume if camera is None else volume.seen_by(camera)
    what = {name: CellQuantity.of(seen, text, name) for name, text in asked.items()}
    parts = CellParts(seen, where, region, samples)
    if aperture is not None or maps:
        return _in_pixels(seen, what, parts, camera, aperture, maps, device)
    return _in_cells(seen, what, parts)


def _asked(quantities: Any, volume: Volume) -> dict[str, Any]:
    """Return name → expression; an expression without a name is called what it is."""
    if quantities is None or (isinstance(quantities, (list, tuple, Mapping)) and not quantities):
        known = ", ".join(volume.fields) or "(none)"
        raise InputError(
            f"say what to measure, such as quantities={_as_dict('mass')}; fields: {known}"
        )
    if not isinstance(quantities, Mapping):
        listed = quantities if isinstance(quantities, (list, tuple)) else [quantities]
        quantities = {str(quantity): quantity for quantity in listed}
    _refuse_totals(quantities.values(), volume)
    return dict(quantities)


def _refuse_totals(listed: Iterable[Any], volume: Volume) -> None:
    """Refuse names of totals in place of what adds up to them: a mass is the sum of a density."""
    for name in listed:
        if isinstance(name, str) and name in _TOTALS and name not in volume.fields:
            error = unknown_name("field", name, volume.fields)
            raise UnknownNameError(
                f"{error}. For a total give name and what adds up: {_as_dict(name)}"
            )


def _as_dict(name: str) -> str:
    return repr({name: _TOTALS[name]})


def _in_cells(volume: Volume, what: dict[str, CellQuantity], parts: CellParts) -> Measurement:
    sums, missing = dict.fromkeys(what, 0.0), dict.fromkeys(what, 0)
    space, cells, grid = 0.0, 0, volume.grid
    volumes = np.asarray(grid.cell_volumes).reshape(-1)
    for first in reported_range(grid.size, CHUNK):
        last = min(first + CHUNK, grid.size)
        share = parts.of(first, last) * volumes[first:last]
        space, cells = space + float(share.sum()), cells + int(np.count_nonzero(share))
        for name, quantity in what.items():
            values = volume.evaluate_cells(quantity.expression, first, last, double=True)
            unknown = np.isnan(values) & (share > 0)
            missing[name] += int(np.count_nonzero(unknown))
            sums[name] += float(np.sum(np.where(unknown | (share == 0), 0.0, values) * share))
    totals = {n: _with_unit(volume, sums[n], q.unit) for n, q in what.items()}
    lacking = {name: count for name, count in missing.items() if count}
    return Measurement(totals, _with_unit(volume, space, None), cells, lacking)


def _in_pixels(
    volume: Volume,
    what: dict[str, CellQuantity],
    parts: CellParts,
    camera: Camera | None,
    aperture: Any,
    maps: bool,
    device: str,
) -> Measurement:
    if camera is None:
        raise InputError("aperture and maps need to know the pixels: give a camera")
    check_exact(volume.grid, camera)
    frame = camera.frame(volume.grid)
    counts = Aperture(aperture, frame, volume.unit).weights()
    every = [*(q.expression for q in what.values()), None]
    columns = exact_maps(volume, every, camera, device, None if parts.everything else parts)
    area = float(np.prod(frame.pixel))
    sums = (columns * counts).sum(axis=(1, 2)) * area
    totals = {
        name: _with_unit(volume, total, q.unit)
        for (name, q), total in zip(what.items(), sums, strict=False)
    }
    plain = _in_cells(volume, what, parts)
    images = {}
    for (name, q), column in zip(what.items(), columns, strict=False):
        unit, factor = column_unit(q.unit, volume.unit)
        text = q.text
        told = {"quantity": text, "method": "exact", "map": f"column of {text}"}
        images[name] = as_map(factor * column * counts, unit, volume, camera, told)
    space = _with_unit(volume, sums[-1], None)
    return Measurement(totals, space, plain.cells, plain.missing, images if maps else {})


def _with_unit(volume: Volume, total: float, unit: Any) -> Any:
    """Return ∫ q dV as a Quantity, lengths taken in the unit that q is made of."""
    own, factor = total_unit(unit, volume.unit)
    own = parse_unit(own)
    return float(total * factor) if own is None else float(total * factor) * own


def _table(
    volume: Volume, quantities: Any, where: Any, cameras: Any, options: Mapping[str, Any]
) -> Any:
    from astropy import units as u
    from astropy.table import QTable

    if not isinstance(cameras, Sequence) or isinstance(cameras, str) or not cameras:
        raise InputError(f"camera must be a camera, or a list of them, got {cameras!r}")
    for number, camera in enumerate(cameras):
        if not isinstance(camera, Camera):
            raise InputError(f"camera must be a list of cameras; number {number} is {camera!r}")
    found = [measure(volume, quantities, where, camera, **options) for camera in cameras]
    table = QTable()
    for name in ("incl", "phi"):
        if all(hasattr(camera, name) for camera in cameras):
            table[name] = [getattr(camera, name) for camera in cameras] * u.deg
    for name in found[0]:
        table[name] = u.Quantity([row[name] for row in found])
    table["volume"] = u.Quantity([row.volume for row in found])
    table["cells"] = [row.cells for row in found]
    table.meta["where"] = "" if where is None else str(where)
    if any(row.missing for row in found):
        table.meta["missing"] = [row.missing for row in found]
    if options["maps"]:
        table.meta["maps"] = [row.maps for row in found]
    return table
