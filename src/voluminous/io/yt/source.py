"""What a user gives: a data set of yt, or a region of one; its cells and values, part by part."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError, UnitsError
from ...packages import require
from ...units import parse_unit, unit_name


@dataclass(frozen=True)
class YtSource:
    """Cells of a data set."""

    ds: Any
    region: Any  # with the cells; of a whole data set all
    whole: bool  # true if these are all cells there are
    kind: str  # how they are kept: "sampled" is an array that yt makes of any

    def cells(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield level (n,) and index (n, 3) of consecutive cells, in yt's order of axes."""
        # Of AMReX with different ratios yt numbers levels with gaps.
        gaps = getattr(self.ds, "level_offsets", ())
        numbers = np.arange(len(gaps)) + gaps
        for part in self.region.chunks([], "io"):
            # As whole numbers: nothing has to be rounded to find a cell.
            level = np.asarray(part.ires)
            yield np.searchsorted(numbers, level) if len(gaps) else level, np.asarray(part.icoords)

    def values(self, field: tuple[str, str], unit: Any) -> np.ndarray:
        """Return a field in all cells, in the order of `cells`, as plain numbers in yt's unit."""
        # Within a part yt keeps what it reads to itself: the user's region stays as it is.
        parts = [plain_values(p[field], unit) for p in self.region.chunks([], "io")]
        return np.concatenate(parts)


def source_of(data: Any) -> YtSource:
    """Return the source that a data set or region is."""
    static = require("yt.data_objects.static_output", "yt", "from_yt")
    containers = require("yt.data_objects.selection_objects.data_selection_objects", "yt", "")
    if isinstance(data, static.Dataset):
        return YtSource(data, data.all_data(), True, _kind(data))
    if not isinstance(data, containers.YTSelectionContainer) or not hasattr(data, "ds"):
        raise InputError(
            f"from_yt needs a data set of yt or a region of one (ds, ds.sphere(…), ds.box(…)), got "
            f"{type(data).__name__}; yt.load(path) gives a data set"
        )
    if getattr(data, "_dimensionality", 0) != 3:
        raise InputError(
            f"from_yt needs a region in three dimensions, got a {data._type_name}; give the data "
            "set, or ds.box(…), ds.sphere(…), ds.disk(…), a cut region …"
        )
    grids = require("yt.data_objects.construction_data_containers", "yt", "from_yt")
    if isinstance(data, grids.YTCoveringGrid):
        return YtSource(data.ds, data, False, "sampled")
    return YtSource(data.ds, data, False, _kind(data.ds))


def _kind(ds: Any) -> str:
    modules = {
        "grids": "yt.geometry.grid_geometry_handler:GridIndex",
        "particles": "yt.geometry.particle_geometry_handler:ParticleIndex",
        "mesh": "yt.geometry.unstructured_mesh_handler:UnstructuredIndex",
    }
    for kind, place in modules.items():
        module, _, name = place.partition(":")
        if isinstance(ds.index, getattr(require(module, "yt", "from_yt"), name)):
            if kind == "mesh":
                raise InputError(
                    f"{ds} is an unstructured mesh (or has uneven cells that yt keeps as one); "
                    "sample it first: vm.Volume.from_yt(ds.arbitrary_grid(left, right, dims))"
                )
            return kind
    return "octree"  # all others have cells that are halved


def plain_values(values: Any, unit: Any) -> np.ndarray:
    """Return an array of yt as plain numbers in a unit of its, of type float64."""
    converted = values.to(unit) if hasattr(values, "units") else values
    return np.asarray(getattr(converted, "d", converted), dtype=np.float64)


_SILENT = logging.CRITICAL + 1
_BARS = ("yt", "suppress_stream_logging")


@contextmanager
def quiet(purpose: str = "reading this file") -> Iterator[Any]:
    """Give yt, with its log, bars and warnings off; all is as before afterwards."""
    yt = require("yt", "yt", purpose)
    logger, config = logging.getLogger("yt"), require("yt.config", "yt", purpose).ytcfg
    level, bars = logger.level, config.get(*_BARS)
    logger.setLevel(_SILENT)
    config.set(*_BARS, True)
    try:
        # Derived fields divide by zero in empty cells.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield yt
    finally:
        logger.setLevel(level)
        config.set(*_BARS, bars)


def meta_of(ds: Any) -> dict[str, Any]:
    """Return what is known of a data set besides its cells."""
    meta: dict[str, Any] = {"dataset": str(ds), "code": str(ds.dataset_type)}
    time: Any = getattr(ds, "current_time", None)
    if hasattr(time, "to"):
        meta |= {"time": float(time.to("s")), "time_unit": "s"}
    if getattr(ds, "cosmological_simulation", 0):
        meta["redshift"] = float(ds.current_redshift)
    return meta


# Constants in the two packages (the parsec, the Sun's mass) differ by less.
_ALIKE = 1e-3
# Of these the two differ in dimension: they are the same in the systems they belong to.
_GAUSSIAN = {"gauss": "G", "G": "G", "uG": "uG", "nG": "nG", "mG": "mG"}


def units_of_field(ds: Any, field: tuple[str, str]) -> tuple[Any, Any]:
    """Return the unit of yt to convert a field to, and that unit in astropy (None: a number).

    It is the unit that yt shows the field in; of a code's own units the cgs unit.
    """
    info = ds._get_field_info(field)
    text = next((t for t in (info.output_units, info.units) if t not in (None, "auto")), None)
    if text is None:
        text = ds.unit_system[info.dimensions] if info.dimensions not in (None, 1) else ""
    unit = require("unyt", "yt", "from_yt").Unit(text, registry=ds.unit_registry)
    found = _in_astropy(unit)
    if found is None:
        unit = unit.get_cgs_equivalent()
        found = _in_astropy(unit)
    return (unit, found) if found is not None else (unit, parse_unit(None))


def _in_astropy(unit: Any) -> Any:
    """Return the same unit in astropy, dimensionless included; None if it has no word for it."""
    from astropy import units as u

    text = str(unit)
    if unit.is_dimensionless and unit.base_value == 1:
        return u.dimensionless_unscaled
    if text in _GAUSSIAN:
        return u.Unit(_GAUSSIAN[text])
    spelt = text.replace("Å", "angstrom").replace("dimensionless", "")
    try:
        found = parse_unit(spelt)
    except UnitsError:
        return None
    if found is None or not hasattr(found, "si"):
        return None
    # "h" is an hour to astropy and may be Hubble's constant to yt: the size tells.
    same = abs(found.si.scale / float(unit.base_value) - 1) < _ALIKE
    return found if same and not unit.base_offset else None


def converted(field: tuple[str, str], unit: Any, wanted: Any) -> tuple[Any, float]:
    """Return a unit asked for, and the factor to it."""
    from astropy import units as u

    target = parse_unit(wanted) or u.dimensionless_unscaled
    try:
        return target, float((unit or u.dimensionless_unscaled).to(target))
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{'/'.join(field)} is in {unit_name(unit) or 'no unit'}, which cannot become {target}"
        ) from error
