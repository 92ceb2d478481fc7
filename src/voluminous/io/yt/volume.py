"""Construction of a volume from a yt data set or region."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import InputError, unknown_name
from ...units import parse_unit
from ..contract import FieldChoice, UnitLike
from .fields import Field, YtFields, cell_fields, particle_fields
from .layout import Load, code_numbers, lattice_of, layout, length_unit
from .source import YtSource, meta_of, plain_values, quiet, source_of, units_of_field

if TYPE_CHECKING:
    from ...grids.contract import Grid
    from ...volume import Volume

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

    wanted = dict(units or {})
    with quiet("from_yt"):
        source = source_of(data)
        known = fields_of(source)
        if source.kind == "particles":
            return _volume_of_particles(source, known, fields, unit, wanted)
        chosen = known.chosen(fields)
        if source.kind == "sampled":
            grid, load = _sampled(source, unit)
        else:
            grid, load = layout(source, lattice_of(source.ds, unit))
        volume = Volume(grid)
        volume.meta.update(meta_of(source.ds))
        for name, field in chosen.items():
            volume[name] = _deferred(source.ds, field, load, wanted.get(name))
    for name in wanted:
        if name not in chosen:
            raise unknown_name("field", name, chosen)
    return volume


def fields_of(source: YtSource) -> YtFields:
    """Return the fields of a source."""
    if source.kind == "particles":
        return particle_fields(source.ds, _particle_kind(source.ds))
    return cell_fields(source.ds)


def _sampled(source: YtSource, unit: UnitLike) -> tuple[Grid, Load]:
    from ...grids import CartesianGrid

    region = source.region
    if str(source.ds.geometry) != "cartesian":
        raise InputError(f"arrays sampled in {source.ds.geometry} coordinates cannot be used")
    ends = np.array([code_numbers(region.left_edge), code_numbers(region.right_edge)])
    unit, factor = length_unit(source.ds, float(np.ptp(ends, axis=0).max()), unit)
    grid = CartesianGrid.uniform(region.ActiveDimensions.tolist(), (ends * factor).T, unit=unit)
    return grid, lambda field, wanted: plain_values(region[field], wanted)


def _deferred(ds: Any, field: Field, load: Load, wanted: Any) -> Deferred:
    loaded_unit, unit, factor = units_of_field(ds, field, wanted)

    def values() -> Any:
        with quiet():
            numbers = load(field, loaded_unit)
        if factor == 1:
            return numbers
        return [n * factor for n in numbers] if isinstance(numbers, list) else numbers * factor

    return Deferred(values, np.float64, unit)


# Particles

_DENSITY = "density"
# yt's kernel names.
_KERNELS = {"wendland2": "wendland-c2", "wendland4": "wendland-c4", "wendland6": "wendland-c6"}


def _particle_kind(ds: Any) -> str:
    """Return the particle type to show: gas, or all if there is no gas."""
    for kind in getattr(ds, "_sph_ptypes", ()):
        if (kind, "particle_mass") in ds.field_info and (kind, _DENSITY) in ds.field_info:
            return str(kind)
    return "all"


def _volume_of_particles(
    source: YtSource, known: YtFields, fields: FieldChoice, unit: UnitLike, units: dict[str, Any]
) -> Volume:
    """Return the volume of a particle data set; see `from_yt`.

    Mesh cells have densities; in yt the smoothing length is the support radius of the kernel.
    """
    from astropy import units as u

    from ...particles import from_particles, get_kernel

    ds, kind = source.ds, _particle_kind(source.ds)

    def plain(name: str, unit: str) -> np.ndarray:
        return plain_values(source.region[kind, name], unit)

    def carried(field: Field, wanted: Any) -> u.Quantity:
        loaded_unit, unit, factor = units_of_field(ds, field, wanted)
        values = plain_values(source.region[field], loaded_unit)
        return u.Quantity(
            values if factor == 1 else values * factor,
            u.dimensionless_unscaled if unit is None else unit,
        )

    chosen = known.chosen(fields) if fields is not None or known.on_disk else {}
    dense = [name for name, field in chosen.items() if field[1] == _DENSITY]
    values = {n: carried(f, units.get(n)) for n, f in chosen.items() if n not in dense}
    unit, factor = length_unit(ds, float(ds.domain_width.to("code_length").d.max()), unit)
    positions = plain("particle_position", "code_length") * factor
    if not len(positions):
        raise InputError("the region has no particles; is it inside the domain?")
    kernel, sizes = _KERNELS.get(str(ds.kernel_name), str(ds.kernel_name)), {}
    if "arepo" in str(ds.dataset_type):
        sizes["density"] = plain(_DENSITY, "g/cm**3") * u.g / u.cm**3
    elif (kind, "smoothing_length") in ds.field_info:
        radius = plain("smoothing_length", "code_length")
        sizes["smoothing_length"] = radius * factor / get_kernel(kernel).support
    masses = plain("particle_mass", "g") * u.g
    volume = from_particles(positions, masses, fields=values, kernel=kernel, unit=unit, **sizes)
    if dense or fields is None:
        name = dense[0] if dense else _DENSITY
        density = volume[_DENSITY].to(parse_unit(units.get(name, "g / cm3")))
        del volume[_DENSITY]
        volume[name] = density
    else:
        del volume[_DENSITY]
    volume.meta.update(meta_of(ds))
    return volume
