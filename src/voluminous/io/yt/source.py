"""Cells, values and units of a yt data set or region."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from ...errors import InputError, UnitsError
from ...packages import require
from ...units import parse_unit, unit_name
from .fields import Field


class YtSource(NamedTuple):
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

    def values(self, field: Field, unit: Any) -> np.ndarray:
        """Return a field in all cells, in the order of `cells`, as plain numbers in a yt unit."""
        # Within a chunk yt caches separately: the user's region object is not modified.
        parts = [plain_values(p[field], unit) for p in self.region.chunks([], "io")]
        return np.concatenate(parts)


_INDICES = {
    "grids": ("yt.geometry.grid_geometry_handler", "GridIndex"),
    "particles": ("yt.geometry.particle_geometry_handler", "ParticleIndex"),
    "mesh": ("yt.geometry.unstructured_mesh_handler", "UnstructuredIndex"),
}


def source_of(data: Any) -> YtSource:
    """Return the source for a yt data set or region."""
    static = require("yt.data_objects.static_output", "yt", "from_yt")
    containers = require("yt.data_objects.selection_objects.data_selection_objects", "yt", "")
    grids = require("yt.data_objects.construction_data_containers", "yt", "from_yt")
    whole = isinstance(data, static.Dataset)
    if not whole and not isinstance(data, containers.YTSelectionContainer):
        raise InputError(
            f"from_yt needs a data set of yt or a region of one (ds, ds.sphere(…), ds.box(…)), got "
            f"{type(data).__name__}; yt.load(path) gives a data set"
        )
    ds, region = (data, data.all_data()) if whole else (data.ds, data)
    if region._dimensionality != 3:
        raise InputError(
            f"from_yt needs a region in three dimensions, got a {data._type_name}; give the data "
            "set, or ds.box(…), ds.sphere(…), ds.disk(…), a cut region …"
        )
    if isinstance(region, grids.YTCoveringGrid):
        return YtSource(ds, region, False, "sampled")
    kinds = (
        kind
        for kind, (module, name) in _INDICES.items()
        if isinstance(ds.index, getattr(require(module, "yt", "from_yt"), name))
    )
    kind = next(kinds, "octree")  # all others have a refinement ratio of 2
    if kind == "mesh":
        raise InputError(
            f"{ds} is an unstructured mesh (or has uneven cells that yt keeps as one); "
            "sample it first: vm.Volume.from_yt(ds.arbitrary_grid(left, right, dims))"
        )
    return YtSource(ds, region, whole, kind)


def plain_values(values: Any, unit: Any) -> np.ndarray:
    """Return a yt array as plain float64 numbers in a yt unit."""
    converted = values.to(unit) if hasattr(values, "units") else values
    return np.asarray(getattr(converted, "d", converted), dtype=np.float64)


@contextmanager
def quiet(purpose: str = "reading this file") -> Iterator[Any]:
    """Yield yt with its log, progress bars and warnings disabled; restore them afterwards."""
    yt = require("yt", "yt", purpose)
    logger, config = logging.getLogger("yt"), require("yt.config", "yt", purpose).ytcfg
    level, bars = logger.level, config.get("yt", "suppress_stream_logging")
    logger.setLevel(logging.CRITICAL + 1)
    config.set("yt", "suppress_stream_logging", True)
    try:
        # Derived fields may divide by zero in empty cells.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield yt
    finally:
        logger.setLevel(level)
        config.set("yt", "suppress_stream_logging", bars)


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


def units_of_field(ds: Any, field: Field, wanted: Any = None) -> tuple[Any, Any, float]:
    """Return the yt unit to convert a field to, our unit, and the factor from one to the other.

    Without a wanted unit it is yt's display unit of the field; for code units, the cgs unit.
    """
    from astropy import units as u

    info = ds._get_field_info(field)
    text = next((t for t in (info.output_units, info.units) if t not in (None, "auto")), None)
    if text is None:
        text = ds.unit_system[info.dimensions] if info.dimensions not in (None, 1) else ""
    unit = require("unyt", "yt", "from_yt").Unit(text, registry=ds.unit_registry)
    ours = _in_astropy(unit)
    if ours is None:
        unit = unit.get_cgs_equivalent()
        ours = _in_astropy(unit)
    if wanted is None:
        return unit, ours, 1.0
    target, ours = (parse_unit(v) or u.dimensionless_unscaled for v in (wanted, ours))
    try:
        return unit, target, float(ours.to(target))
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{'/'.join(field)} is in {unit_name(ours) or 'no unit'}, which cannot become {target}"
        ) from error


def _in_astropy(unit: Any) -> Any:
    """Return the equivalent astropy unit, including dimensionless; None if there is none."""
    from astropy import units as u

    text = str(unit)
    if unit.is_dimensionless and unit.base_value == 1:
        return u.dimensionless_unscaled
    if text in _GAUSSIAN:
        return u.Unit(_GAUSSIAN[text])
    try:
        ours = parse_unit(text.replace("Å", "angstrom").replace("dimensionless", ""))
    except UnitsError:
        return None
    if ours is None or not hasattr(ours, "si"):
        return None
    # "h" is an hour in astropy but may be Hubble's constant in yt: compare the sizes.
    same = abs(ours.si.scale / float(unit.base_value) - 1) < _ALIKE
    return ours if same and not unit.base_offset else None
