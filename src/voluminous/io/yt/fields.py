"""The fields of a yt data set, and their names in voluminous."""

from __future__ import annotations

import difflib
from typing import Any

from ...errors import InputError, UnknownNameError
from ..contract import FieldChoice
from ..names import chosen_fields, field_name

Field = tuple[str, str]
# R and phi are called r and theta in yt's cylindrical coordinates.
_CYLINDRICAL = {"r": "R", "theta": "phi"}
# Particle positions, sizes and identifiers.
_NOT_CARRIED = {"position", "position_x", "position_y", "position_z", "x", "y", "z", "mass"} | {
    "index",
    "type",
    "density",
    "smoothing_length",
    "ones",
}


class YtFields:
    """The fields of a data set."""

    def __init__(
        self, stored: list[Field], derived: list[Field], endings: dict[str, str] | None = None
    ) -> None:
        self._fields = {"/".join(f): f for f in dict.fromkeys((*stored, *derived))}
        self._names = _names(self._fields, endings or {})
        self.on_disk = {"/".join(f): self._names["/".join(f)] for f in stored}

    def chosen(self, fields: FieldChoice) -> dict[str, Field]:
        """Return {name: field} for the requested fields; see `voluminous.Volume.from_yt`."""
        if fields is None:
            if not self.on_disk:
                raise InputError("the data set has no field in cells; name one that yt derives")
            chosen = chosen_fields(self.on_disk, None)
        else:
            chosen = self._chosen(self._as_text(fields))
        return {name: self._fields[place] for name, place in chosen.items()}

    def _chosen(self, asked: Any) -> dict[str, str]:
        try:
            return chosen_fields(self._names, asked)
        except UnknownNameError as error:
            # yt derives hundreds: listing all would hide the nearest one.
            raise self._unknown(asked) from error

    def _as_text(self, fields: Any) -> Any:
        """Replace tuples such as ``("gas", "density")`` and yt field objects by places."""
        if isinstance(fields, dict):
            return {name: _place(field) for name, field in fields.items()}
        return [_place(field) for field in ([fields] if self._is_one(fields) else fields)]

    def _is_one(self, fields: Any) -> bool:
        if isinstance(fields, tuple):
            return len(fields) == 2 and any(fields[0] == kind for kind, _ in self._fields.values())
        return isinstance(fields, str) or hasattr(fields, "name")

    def _unknown(self, asked: Any) -> UnknownNameError:
        known = {*self._names, *self._names.values()}
        texts = list(asked.values()) if isinstance(asked, dict) else list(asked)
        bad = next((str(text) for text in texts if text not in known), str(texts))
        near = difflib.get_close_matches(bad, sorted(known), n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        return UnknownNameError(
            f"unknown field {bad!r}; {hint}in the file: {', '.join(self.on_disk.values())}; yt "
            f"derives {len(self._fields) - len(self.on_disk)} more (ds.derived_field_list)"
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
    others = sorted(filter(in_cells, ds.derived_field_list), key=_order)
    around_axis = str(ds.geometry) in ("cylindrical", "polar")
    return YtFields(stored, others, _CYLINDRICAL if around_axis else None)


def particle_fields(ds: Any, kind: str) -> YtFields:
    """Return the fields with one value per particle of a type."""
    stored = [_common(ds, field, kind) for field in ds.field_list if field[0] == kind]
    stored = [f for f in stored if f[1].lower().removeprefix("particle_") not in _NOT_CARRIED]
    others = [f for f in ds.derived_field_list if f[0] in ("gas", kind)]
    return YtFields(stored, sorted(others, key=_order))


def _order(field: Field) -> tuple[bool, Field]:
    return field[0] != "gas", field


def _common(ds: Any, field: Field, kind: str) -> Field:
    """Return the yt common name of an on-disk field, or the field itself if there is none."""
    aliases = ds.field_info.field_aliases
    known = [a for a in aliases if a[0] in ("gas", kind) and _root(aliases, a) == field]
    known = sorted((a for a in known if a in ds.field_info), key=lambda a: a[0] != "gas")
    return known[0] if known else field


def _root(aliases: Any, field: Field) -> Field:
    for _ in range(len(aliases)):
        if aliases.get(field, field) == field:
            break
        field = aliases[field]
    return field


def _names(fields: dict[str, Field], endings: dict[str, str]) -> dict[str, str]:
    """Return {place: name}; of equal names all but the first get their type as a prefix."""
    names: dict[str, str] = {}
    taken: set[str] = set()
    for place, (kind, last) in fields.items():
        stem, line, ending = last.replace("/", "_").rpartition("_")
        name = stem + line + (endings.get(ending, ending) if line else ending)
        name = field_name(f"{kind}_{name}" if field_name(name) in taken else name)
        taken.add(name)
        names[place] = name
    return names
