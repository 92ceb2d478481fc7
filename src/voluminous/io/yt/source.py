"""Cells and values of a yt data set or region, read in chunks."""

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
    """The cells of a data set or region."""

    ds: Any
    region: Any  # the data object with the cells; all data for a whole data set
    whole: bool  # true if these are all cells of the data set
    kind: str  # storage layout; "sampled" is an array that yt resamples from any layout

    def cells(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield level (n,) and index (n, 3) of consecutive cells, in yt's axis order."""
        # For AMReX data with varying refinement ratios, yt's level numbers have gaps.
        gaps = getattr(self.ds, "level_offsets", ())
        numbers = np.arange(len(gaps)) + gaps
        for part in self.region.chunks([], "io"):
            # Integers: no rounding is needed to locate a cell.
            level = np.asarray(part.ires)
            yield np.searchsorted(numbers, level) if len(gaps) else level, np.asarray(part.icoords)

    def values(self, field: tuple[str, str], unit: Any) -> np.ndarray:
        """Return a field in all cells, in the order of `cells`, as plain numbers in a yt unit."""
        # Within a chunk yt caches separately: the user's region object is not modified.
        parts = [plain_values(p[field], unit) for p in self.region.chunks([], "io")]
        return np.concatenate(parts)


def source_of(data: Any) -> YtSource:
    """Return the source for a yt data set or region."""
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
    return "octree"  # all others have a refinement ratio of 2


def plain_values(values: Any, unit: Any) -> np.ndarray:
    """Return a yt array as plain float64 numbers in a yt unit."""
    converted = values.to(unit) if hasattr(values, "units") else values
    return np.asarray(getattr(converted, "d", converted), dtype=np.float64)


_SILENT = logging.CRITICAL + 1
_BARS = ("yt", "suppress_stream_logging")


@contextmanager
def quiet(purpose: str = "reading this file") -> Iterator[Any]:
    """Yield yt with its log, progress bars and warnings disabled; restore them afterwards."""
    yt = require("yt", "yt", purpose)
    logger, config = logging.getLogger("yt"), require("yt.config", "yt", purpose).ytcfg
    level, bars = logger.level, config.get(*_BARS)
    logger.setLevel(_SILENT)
    config.set(*_BARS, True)
    try:
        # Derived fields may divide by zero in empty cells.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield yt
    finally:
        logger.setLevel(level)
        config.set(*_BARS, bars)


def meta_of(ds: Any) -> dict[str, Any]:
    """Return the metadata of a data set."""
    meta: dict[str, Any] = {"dataset": str(ds), "code": str(ds.dataset_type)}
    time: Any = getattr(ds, "current_time", None)
    if hasattr(time, "to"):
        meta |= {"time": float(time.to("s")), "time_unit": "s"}
    if getattr(ds, "cosmological_simulation", 0):
        meta["redshift"] = float(ds.current_redshift)
    return meta


# The two packages' constants (parsec, solar mass) differ by less than this.
_ALIKE = 1e-3
# The packages give these units different dimensions; within their unit systems they are equal.
_GAUSSIAN = {"gauss": "G", "G": "G", "uG": "uG", "nG": "nG", "mG": "mG"}


def units_of_field(ds: Any, field: tuple[str, str]) -> tuple[Any, Any]:
    """Return the yt unit to convert a field to, and its astropy equivalent (None: dimensionless).

    It is yt's display unit of the field; for code units, the cgs unit.
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
    """Return the equivalent astropy unit, including dimensionless; None if there is none."""
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
    # "h" is an hour in astropy but may be Hubble's constant in yt: compare the sizes.
    same = abs(found.si.scale / float(unit.base_value) - 1) < _ALIKE
    return found if same and not unit.base_offset else None


def converted(field: tuple[str, str], unit: Any, wanted: Any) -> tuple[Any, float]:
    """Return the requested unit, and the conversion factor to it."""
    from astropy import units as u

    target = parse_unit(wanted) or u.dimensionless_unscaled
    try:
        return target, float((unit or u.dimensionless_unscaled).to(target))
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{'/'.join(field)} is in {unit_name(unit) or 'no unit'}, which cannot become {target}"
        ) from error
