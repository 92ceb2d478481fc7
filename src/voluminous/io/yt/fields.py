"""The fields of a yt data set, and their names in voluminous."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

from ...errors import InputError, UnknownNameError
from ..contract import FieldChoice
from ..names import chosen_fields, field_name

Field = tuple[str, str]
# R and phi are called r and theta in yt's cylindrical coordinates.
_CYLINDRICAL = {"r": "R", "theta": "phi"}
# Particle positions, sizes and identifiers.
_NOT_CARRIED = {"position", "position_x", "position_y", "position_z", "x", "y", "z", "mass"} | {
    *("index", "type", "density", "smoothing_length", "ones")
}


class YtFields:
    """The fields of a data set, stored and derived, by place and by name.

    Of fields of equal name all but the first get their type as a prefix.
    """

    def __init__(self, stored: list[Field], derived: Iterable[Field], around_axis: bool) -> None:
        self.fields = {"/".join(f): f for f in (*stored, *derived)}
        self.names: dict[str, str] = {}
        taken: set[str] = set()
        for place, (kind, last) in self.fields.items():
            stem, line, ending = last.replace("/", "_").rpartition("_")
            if line and around_axis:
                ending = _CYLINDRICAL.get(ending, ending)
            name = field_name(stem + line + ending)
            name = field_name(f"{kind}_{stem}{line}{ending}") if name in taken else name
            taken.add(name)
            self.names[place] = name
        self.on_disk = {"/".join(f): self.names["/".join(f)] for f in stored}

    def chosen(self, fields: Any) -> dict[str, Field]:
        """Return {name: field} for the requested fields; see `voluminous.Volume.from_yt`."""
        if fields is None:
            if not self.on_disk:
                raise InputError("the data set has no field in cells; name one that yt derives")
            places = chosen_fields(self.on_disk, None)
        else:
            if not isinstance(fields, (dict, list)):
                kinds = {kind for kind, _ in self.fields.values()}
                pair = isinstance(fields, tuple) and len(fields) == 2 and fields[0] in kinds
                several = isinstance(fields, tuple) and not pair
                fields = list(fields) if several else [fields]
            choice: FieldChoice = (
                {name: _place(field) for name, field in fields.items()}
                if isinstance(fields, dict)
                else [_place(field) for field in fields]
            )
            try:
                places = chosen_fields(self.names, choice)
            except UnknownNameError as error:
                raise self._unknown(choice) from error
        return {name: self.fields[place] for name, place in places.items()}

    def _unknown(self, choice: Any) -> UnknownNameError:
        """Return an error with the nearest name: yt derives hundreds."""
        known = {*self.names, *self.names.values()}
        texts = list(choice.values()) if isinstance(choice, dict) else list(choice)
        bad = next((str(text) for text in texts if text not in known), str(texts))
        near = difflib.get_close_matches(bad, sorted(known), n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        return UnknownNameError(
            f"unknown field {bad!r}; {hint}in the file: {', '.join(self.on_disk.values())}; yt "
            f"derives {len(self.fields) - len(self.on_disk)} more (ds.derived_field_list)"
        )


def _place(field: Any) -> Any:
    field = getattr(field, "name", field)  # for ds.fields.gas.density
    return "/".join(map(str, field)) if isinstance(field, tuple) else field


def cell_fields(ds: Any) -> YtFields:
    """Return the fields with one value per cell."""

    def in_cells(field: Field) -> bool:
        info = ds.field_info.get(field)
        cells = info is not None and str(info.sampling_type) in ("cell", "local")
        return cells and field[0] not in ds.particle_types

    stored = [_common(ds, field, "gas") for field in ds.field_list if in_cells(field)]
    derived = sorted(filter(in_cells, ds.derived_field_list), key=_gas_first)
    return YtFields(stored, derived, str(ds.geometry) in ("cylindrical", "polar"))


def particle_fields(ds: Any, kind: str) -> YtFields:
    """Return the fields with one value per particle of a type."""
    stored = [_common(ds, field, kind) for field in ds.field_list if field[0] == kind]
    stored = [f for f in stored if f[1].lower().removeprefix("particle_") not in _NOT_CARRIED]
    derived = [f for f in ds.derived_field_list if f[0] in ("gas", kind)]
    return YtFields(stored, sorted(derived, key=_gas_first), False)


def _gas_first(field: Field) -> tuple[bool, Field]:
    return field[0] != "gas", field


def _common(ds: Any, field: Field, kind: str) -> Field:
    aliases = ds.field_info.field_aliases

    def stands_for_it(alias: Field) -> bool:
        for _ in range(len(aliases)):  # aliases of aliases
            alias, before = aliases.get(alias, alias), alias
            if alias == before:
                break
        return alias == field

    known = [a for a in aliases if a[0] in ("gas", kind) and a in ds.field_info]
    return min(filter(stands_for_it, known), key=lambda a: a[0] != "gas", default=field)
