"""Particles of yt, laid on an octree."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from .fields import Field, Fields
from .lattice import length_unit
from .meta import meta_of
from .source import Source, plain_values
from .units import converted, units_of_field

if TYPE_CHECKING:
    from ...volume import Volume

_DENSITY = "density"
# yt's names of kernels.
_KERNELS = {"wendland2": "wendland-c2", "wendland4": "wendland-c4", "wendland6": "wendland-c6"}


def particle_kind(ds: Any) -> str:
    """Return the particles to be shown: gas, or where there is none all."""
    for kind in getattr(ds, "_sph_ptypes", ()):
        if (kind, "particle_mass") in ds.field_info and (kind, _DENSITY) in ds.field_info:
            return str(kind)
    return "all"


def volume_of_particles(
    source: Source, known: Fields, fields: Any, unit: Any, units: dict[str, Any]
) -> Volume:
    """Return the volume of particles; see `from_yt`."""
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


def _sizes(source: Source, kind: str, factor: float, support: float) -> dict[str, Any]:
    """Return what tells how large particles are: cells by their density, others by h."""
    from astropy import units as u

    ds = source.ds
    if "arepo" in str(ds.dataset_type):
        return {"density": _plain(source, (kind, _DENSITY), "g/cm**3") * u.g / u.cm**3}
    if (kind, "smoothing_length") not in ds.field_info:
        return {}
    # To yt it is the radius at which the kernel ends.
    radius = _plain(source, (kind, "smoothing_length"), "code_length")
    return {"smoothing_length": radius * factor / support}


def _values(source: Source, field: Field, wanted: Any) -> Any:
    """Return what particles carry, as a Quantity, in the unit wanted or yt's."""
    from astropy import units as u

    own, unit = units_of_field(source.ds, field)
    values = _plain(source, field, own)
    if wanted is not None:
        unit, factor = converted(field, unit, wanted)
        values = values * factor
    return u.Quantity(values, unit if unit is not None else u.dimensionless_unscaled)


def _plain(source: Source, field: Field, unit: Any) -> np.ndarray:
    return plain_values(source.region[field], unit)


def _set_density(volume: Volume, name: str, units: dict[str, Any]) -> None:
    from astropy import units as u

    wanted = units.get(name, "g / cm3")
    unit, factor = converted(("gas", _DENSITY), volume.field_unit(_DENSITY), wanted)
    values = volume.array(_DENSITY) * factor
    if name != _DENSITY:
        del volume[_DENSITY]
    volume[name] = u.Quantity(values, unit)
