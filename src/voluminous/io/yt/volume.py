"""Construction of a volume from a yt data set or region."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import InputError, unknown_name
from ..contract import FieldChoice, UnitLike
from .fields import Field, YtFields, cell_fields, particle_fields
from .layout import lattice_of, length_unit
from .source import YtSource, converted, meta_of, plain_values, quiet, source_of, units_of_field

if TYPE_CHECKING:
    from ...volume import Volume
    from .layout import Load


_DENSITY = "density"
# yt's kernel names.
_KERNELS = {"wendland2": "wendland-c2", "wendland4": "wendland-c4", "wendland6": "wendland-c6"}


def particle_kind(ds: Any) -> str:
    """Return the particle type to show: gas, or all if there is no gas."""
    for kind in getattr(ds, "_sph_ptypes", ()):
        if (kind, "particle_mass") in ds.field_info and (kind, _DENSITY) in ds.field_info:
            return str(kind)
    return "all"


def volume_of_particles(
    source: YtSource, known: YtFields, fields: FieldChoice, unit: UnitLike, units: dict[str, Any]
) -> Volume:
    """Return the volume of a particle data set; see `from_yt`."""
    from ...particles import from_particles, get_kernel

    ds, kind = source.ds, particle_kind(source.ds)
    chosen = known.chosen(fields) if fields is not None or known.on_disk else {}
    dense = [name for name, field in chosen.items() if field[1] == _DENSITY]
    carried = {
        name: _values(source, field, units.get(name))
        for name, field in chosen.items()
        if name not in dense
    }
    unit, factor = length_unit(ds, float(ds.domain_width.to("code_length").d.max()), unit)
    positions = _plain(source, (kind, "particle_position"), "code_length") * factor
    if not len(positions):
        raise InputError("the region has no particles; is it inside the domain?")
    from astropy import units as u

    name = _KERNELS.get(str(ds.kernel_name), str(ds.kernel_name))
    size = _sizes(source, kind, factor, get_kernel(name).support)
    masses = _plain(source, (kind, "particle_mass"), "g") * u.g
    volume = from_particles(positions, masses, fields=carried, kernel=name, unit=unit, **size)
    if dense or fields is None:
        _set_density(volume, dense[0] if dense else _DENSITY, units)
    else:
        del volume[_DENSITY]
    volume.meta.update(meta_of(ds))
    return volume


def _sizes(source: YtSource, kind: str, factor: float, support: float) -> dict[str, Any]:
    """Return the size arguments: densities for mesh cells, smoothing lengths for particles."""
    from astropy import units as u

    ds = source.ds
    if "arepo" in str(ds.dataset_type):
        return {"density": _plain(source, (kind, _DENSITY), "g/cm**3") * u.g / u.cm**3}
    if (kind, "smoothing_length") not in ds.field_info:
        return {}
    # In yt it is the support radius of the kernel.
    radius = _plain(source, (kind, "smoothing_length"), "code_length")
    return {"smoothing_length": radius * factor / support}


def _values(source: YtSource, field: Field, wanted: Any) -> Any:
    """Return particle values as a Quantity, in the requested unit or yt's."""
    from astropy import units as u

    own, unit = units_of_field(source.ds, field)
    values = _plain(source, field, own)
    if wanted is not None:
        unit, factor = converted(field, unit, wanted)
        values = values * factor
    return u.Quantity(values, unit if unit is not None else u.dimensionless_unscaled)


def _plain(source: YtSource, field: Field, unit: UnitLike) -> np.ndarray:
    return plain_values(source.region[field], unit)


def _set_density(volume: Volume, name: str, units: dict[str, Any]) -> None:
    from astropy import units as u

    wanted = units.get(name, "g / cm3")
    unit, factor = converted(("gas", _DENSITY), volume.field_unit(_DENSITY), wanted)
    values = volume.array(_DENSITY) * factor
    if name != _DENSITY:
        del volume[_DENSITY]
    volume[name] = u.Quantity(values, unit)


# Fields of up to this many bytes in total are read at once; beyond, each is read on first use.
_AT_ONCE = 256 << 20


def from_yt(
    data: Any,
    fields: FieldChoice = None,
    *,
    unit: UnitLike = None,
    units: Mapping[str, Any] | None = None,
) -> Volume:
    """Return the volume of a yt data set, or of a region of one, on its original cells.

    Nothing is resampled: octrees become an `OctreeGrid`, grids of several levels a `PatchGrid` (in
    spherical and cylindrical coordinates a refined `SphericalGrid` or `CylindricalGrid`), and cells
    of one level a regular grid. Particles are deposited on an octree by `from_particles`: the gas,
    or the masses of all particles if there is no gas.

    Parameters
    ----------
    data : yt Dataset or data object
        ``ds``, or a three-dimensional part of it: ``ds.box(left, right)``, ``ds.sphere(…)``, a cut
        region, a covering or arbitrary grid … Only the required data are read. The grid is the box
        around the selected cells; other cells in the box have the value NaN.
    fields : str, tuple, sequence or dict, optional
        ``"density"``, ``("gas", "density")``, ``"gas/density"``, several of them, or ``{name:
        field}``. Fields derived by yt are allowed, and ``"velocity"`` selects three components.
        Default: all fluid fields in the file, under yt's common names where they have one.
    unit : str or unit, optional
        Unit of length. Default: the largest of nm, um, mm, cm, m, km, solRad, au, pc, kpc, Mpc and
        Gpc in which the domain is at least 1 wide. Lengths are proper, not comoving.
    units : dict, optional
        Units of fields, ``{name: unit}``. Default: yt's display units.

    Returns
    -------
    Volume
        Its `meta` has ``dataset``, ``code``, ``time`` (in ``time_unit``) and, for cosmological
        simulations, ``redshift``. Values are double precision, unchanged from yt.

    Raises
    ------
    InputError
        If `data` has no three-dimensional cells, or if no grid type supports its cells.
    UnknownNameError
        If a field does not exist; the message names the nearest.
    UnitsError
        If a field cannot be converted to the requested unit.
    MissingPackageError
        If yt is not installed.

    Notes
    -----
    Fields of up to 256 MiB in total are read at once. If they take more, each is read on first use,
    and the data set must not be changed until then.

    Examples
    --------
    >>> ds = yt.load("output_00080")  # doctest: +SKIP
    >>> volume = vm.Volume.from_yt(ds, ["density", "velocity_x"], unit="kpc")  # doctest: +SKIP
    """
    volume = volume_of(data, fields, unit=unit, units=units)
    return volume.load() if volume.bytes_waiting <= _AT_ONCE else volume


def volume_of(
    data: Any,
    fields: FieldChoice = None,
    *,
    unit: UnitLike = None,
    units: Mapping[str, Any] | None = None,
) -> Volume:
    """Return the volume with all fields unread; see `from_yt`."""
    from ...volume import Volume

    with quiet("from_yt"):
        source = source_of(data)
        known = fields_of(source)
        if source.kind == "particles":
            return volume_of_particles(source, known, fields, unit, dict(units or {}))
        chosen = known.chosen(fields)
        grid, load = _layout(source, unit)
        volume = Volume(grid)
        volume.meta.update(meta_of(source.ds))
        for name, field in chosen.items():
            volume[name] = _deferred(source.ds, field, load, (units or {}).get(name))
    for name in units or {}:
        if name not in chosen:
            raise unknown_name("field", name, chosen)
    return volume


def fields_of(source: YtSource) -> YtFields:
    """Return the fields of a source."""
    if source.kind == "particles":
        return particle_fields(source.ds, particle_kind(source.ds))
    return cell_fields(source.ds)


def _layout(source: YtSource, unit: UnitLike) -> tuple[Any, Load]:
    if source.kind == "sampled":
        return _sampled(source, unit)
    from .layout import layout

    return layout(source, lattice_of(source.ds, unit))


def _sampled(source: YtSource, unit: UnitLike) -> tuple[Any, Load]:
    from ...grids import CartesianGrid

    region = source.region
    if str(source.ds.geometry) != "cartesian":
        raise InputError(f"arrays sampled in {source.ds.geometry} coordinates cannot be used")
    ends = np.array([_code_lengths(region.left_edge), _code_lengths(region.right_edge)])
    unit, factor = length_unit(source.ds, float(np.ptp(ends, axis=0).max()), unit)
    grid = CartesianGrid.uniform(region.ActiveDimensions.tolist(), (ends * factor).T, unit=unit)
    return grid, lambda field, wanted: plain_values(region[field], wanted)


def _code_lengths(values: Any) -> np.ndarray:
    return np.asarray(values.to("code_length").d)


def _deferred(ds: Any, field: tuple[str, str], load: Load, wanted: Any) -> Deferred:
    own, unit = units_of_field(ds, field)
    factor = 1.0
    if wanted is not None:
        unit, factor = converted(field, unit, wanted)
    return Deferred(functools.partial(_load, load, field, own, factor), np.float64, unit)


def _load(load: Load, field: tuple[str, str], unit: UnitLike, factor: float) -> Any:
    with quiet():
        values = load(field, unit)
    return values if factor == 1 else values * factor
