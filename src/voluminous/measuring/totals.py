"""Totals: mass, momentum and energy of all cells, or of a part of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ..cameras import Camera
from ..errors import InputError, UnknownNameError, check_flag, unknown_name
from ..large.partition import partition_of
from ..notebook import page, table
from ..progress import Progress, with_progress
from ..regions import Region
from ..units import Unit, parse_unit
from .cells import CellParts, CellQuantity, blocks, check_volume, integral_unit
from .columns import as_map, check_exact, exact_maps
from .shapes import aperture_weights

if TYPE_CHECKING:
    from astropy.table import QTable
    from astropy.units import Quantity

    from ..expressions import Expression
    from ..image import Image
    from ..volume import Volume

    Quantities: TypeAlias = str | Expression | Sequence[str] | Mapping[str, str | Expression]

# Names of totals, and the quantities that add up to them.
_TOTALS = {
    "mass": "density",
    "momentum": "density * los('velocity')",
    "energy": "0.5 * density * norm('velocity')**2",
    "kinetic_energy": "0.5 * density * norm('velocity')**2",
}
# Cells evaluated at once.
_CHUNK = 1 << 18


@dataclass(frozen=True)
class Measurement(Mapping[str, Any]):
    """Totals by name: numbers, or Quantities where they have a unit.

    Attributes
    ----------
    totals : dict
        ∫ q dV of all quantities, over the measured cells.
    volume : float or Quantity
        The measured volume.
    cells : int
        The number of cells measured, at least in part.
    missing : dict of str to int
        In how many of these cells a quantity has no value: they count nothing.
    means, minima, maxima : dict of str to float or Quantity
        Mean by volume, least and largest value in these cells; none of an aperture, or where no
        cell has a value.
    maps : dict of str to Image
        Columns ∫ q ds per pixel, if asked for.
    """

    totals: dict[str, float | Quantity]
    volume: float | Quantity
    cells: int
    missing: dict[str, int] = field(default_factory=dict)
    maps: dict[str, Image] = field(default_factory=dict)
    means: dict[str, float | Quantity] = field(default_factory=dict)
    minima: dict[str, float | Quantity] = field(default_factory=dict)
    maxima: dict[str, float | Quantity] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Any:
        return self.totals[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.totals)

    def __len__(self) -> int:
        return len(self.totals)

    def __str__(self) -> str:
        width = max(map(len, self.totals))
        lines = [f"{name:{width}}  {value:.8g}" for name, value in self.totals.items()]
        return "\n".join([*lines, f"in {self.cells} cells, volume {self.volume:.6g}"])

    def _repr_html_(self) -> str:
        rows = [(name, f"{value:.8g}") for name, value in self.totals.items()]
        for word, values in (
            ("mean", self.means),
            ("least", self.minima),
            ("largest", self.maxima),
        ):
            rows += [(f"{word} {name}", f"{value:.8g}") for name, value in values.items()]
        rows += [("volume", f"{self.volume:.6g}"), ("cells", str(self.cells))]
        rows += [(f"cells without {name}", str(n)) for name, n in self.missing.items() if n]
        return page("Measurement", table(rows))


@with_progress
def measure(
    volume: Volume,
    quantities: Quantities | None = None,
    where: str | Expression | None = None,
    camera: Camera | Sequence[Camera] | None = None,
    *,
    clip: Region | str | None = None,
    aperture: Any = None,
    maps: bool = False,
    samples: int = 4,
    memory: Any = None,
    device: str = "auto",
    progress: Progress = None,
) -> Measurement | QTable:
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
    clip : Region or str, optional
        A part of space, see `voluminous.regions`; or a text such as ``"sphere((0, 0, 0), 100 AU)"``
        with ``box(low, high)``, ``halfspace(point, normal)``, ``cylinder(start, end, radius)``,
        ``cone`` and ``doublecone(apex, axis, opening, height)``, combined by ``&``, ``|`` and
        ``~``. Of a cell on its surface that
        part counts which has the centres of ``samples**3`` parts of the cell inside, or of more
        where it goes far around the axis; in a box, exactly its part.
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
        See `clip`.
    memory : str or int, optional
        As for `render`: the volume is read and measured chunk by chunk. Sums are the same to
        rounding: their order is another.
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
    named = _named(quantities, volume)
    if camera is not None and not isinstance(camera, Camera):
        if not isinstance(camera, Sequence) or isinstance(camera, str) or not camera:
            raise InputError(f"camera must be a camera, or a list of them, got {camera!r}")
        for number, one in enumerate(camera):
            if not isinstance(one, Camera):
                raise InputError(f"camera must be a list of cameras; number {number} is {one!r}")
        options: dict[str, Any] = {"clip": clip, "aperture": aperture, "maps": maps}
        options |= {"samples": samples, "memory": memory}
        options |= {"device": device, "progress": progress}
        rows = [measure(volume, quantities, where, one, **options) for one in camera]
        return _table(camera, rows, where)
    check_flag("maps", maps)
    volume.refresh()  # derivatives of fields that were changed in place
    volume = partition_of(volume, memory).volume
    seen = volume if camera is None else volume.seen_by(camera)
    what = {name: CellQuantity.of(seen, text, name) for name, text in named.items()}
    parts = CellParts(seen, where, clip, samples)
    if aperture is None and not maps:
        return _in_cells(seen, what, parts, memory)
    if camera is None:
        raise InputError("aperture and maps need to know the pixels: give a camera")
    check_exact(seen.grid, camera)
    return _in_pixels(seen, what, parts, camera, aperture, maps, device, memory)


def _named(quantities: Any, volume: Volume) -> dict[str, Any]:
    """Return name → expression; an expression without a name is named after itself."""
    if quantities is None or (isinstance(quantities, (list, tuple, Mapping)) and not quantities):
        known = ", ".join(volume.fields) or "(none)"
        example = {"mass": _TOTALS["mass"]}
        raise InputError(f"say what to measure, such as quantities={example}; fields: {known}")
    if not isinstance(quantities, Mapping):
        listed = quantities if isinstance(quantities, (list, tuple)) else [quantities]
        quantities = {str(quantity): quantity for quantity in listed}
    for name in quantities.values():  # a mass is the sum of a density
        if isinstance(name, str) and name in _TOTALS and name not in volume.fields:
            error, example = unknown_name("field", name, volume.fields), {name: _TOTALS[name]}
            raise UnknownNameError(f"{error}. For a total give name and what adds up: {example}")
    return dict(quantities)


def _in_cells(
    volume: Volume, what: dict[str, CellQuantity], parts: CellParts, memory: Any
) -> Measurement:
    sums, missing = dict.fromkeys(what, 0.0), dict.fromkeys(what, 0)
    known, low, high = (dict.fromkeys(what, start) for start in (0.0, np.inf, -np.inf))
    names = [*parts.names, *(name for q in what.values() for name in q.expression.names)]
    space, cells = 0.0, 0
    for block in blocks(partition_of(volume, memory), names, _CHUNK, parts):
        volumes = np.asarray(block.volume.grid.cell_volumes).reshape(-1)
        for first, last in block.ranges:
            share = parts.of(block.volume, first, last) * volumes[first:last]
            counted = share > 0
            if not (count := int(np.count_nonzero(counted))):
                continue
            space, cells = space + float(share.sum()), cells + count
            for name, quantity in what.items():
                values = block.volume.evaluate_cells(quantity.expression, first, last, double=True)
                values = np.broadcast_to(values, share.shape)
                there = counted & ~np.isnan(values)
                missing[name] += count - int(np.count_nonzero(there))
                known[name] += float(np.sum(share, where=there))
                sums[name] += float(np.sum(np.where(there, values, 0.0) * share))
                low[name] = float(np.min(values, where=there, initial=low[name]))
                high[name] = float(np.max(values, where=there, initial=high[name]))
    totals = {name: _with_unit(volume, sums[name], q.unit) for name, q in what.items()}
    lacking = {name: count for name, count in missing.items() if count}

    def of_known(values: dict[str, float]) -> dict[str, Any]:
        units = {name: q.unit for name, q in what.items() if known[name] > 0}
        return {n: values[n] if u is None else values[n] * u for n, u in units.items()}

    means = {name: sums[name] / (known[name] or np.nan) for name in what}
    statistics = (of_known(values) for values in (means, low, high))
    space = _with_unit(volume, space, None)
    return Measurement(totals, space, cells, lacking, {}, *statistics)


def _in_pixels(
    volume: Volume,
    what: dict[str, CellQuantity],
    parts: CellParts,
    camera: Camera,
    aperture: Any,
    maps: bool,
    device: str,
    memory: Any,
) -> Measurement:
    frame = camera.frame(volume.grid)
    weights = aperture_weights(aperture, frame, volume.unit)
    every = [*(q.expression for q in what.values()), None]
    columns = exact_maps(volume, every, camera, device, memory, parts) * weights
    *sums, space = columns.sum(axis=(1, 2)) * float(np.prod(frame.pixel))
    totals, images = {}, {}
    for (name, q), total, column in zip(what.items(), sums, columns[:-1], strict=True):
        totals[name] = _with_unit(volume, total, q.unit)
        unit, factor = integral_unit(q.unit, volume.unit)
        how = {"quantity": q.text, "method": "exact", "map": f"column of {q.text}"}
        images[name] = as_map(factor * column, unit, volume, camera, how)
    plain = _in_cells(volume, what, parts, memory)
    space = _with_unit(volume, space, None)
    return Measurement(totals, space, plain.cells, plain.missing, images if maps else {})


def _with_unit(volume: Volume, total: float, unit: Unit) -> Any:
    own, factor = integral_unit(unit, volume.unit, 3)
    own = parse_unit(own)
    return float(total * factor) if own is None else float(total * factor) * own


def _table(cameras: Sequence[Camera], rows: list[Measurement], where: Any) -> QTable:
    from astropy import units as u
    from astropy.table import QTable

    table = QTable()
    for name in ("incl", "phi"):
        if all(hasattr(camera, name) for camera in cameras):
            table[name] = [getattr(camera, name) for camera in cameras] * u.deg
    for name in rows[0]:
        table[name] = u.Quantity([row[name] for row in rows])
    table["volume"] = u.Quantity([row.volume for row in rows])
    table["cells"] = [row.cells for row in rows]
    table.meta["where"] = "" if where is None else str(where)
    for name in ("missing", "maps"):
        if any(getattr(row, name) for row in rows):
            table.meta[name] = [getattr(row, name) for row in rows]
    return table
