"""The section ``[volume]``: a file or a model, and derived fields."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..errors import InputError, check_name
from ..expressions import Expression
from ..files import seen_from
from ..io.contract import FieldChoice
from ..io.guard import placed
from ..units import parse_unit
from ..volume import Volume
from . import kinds
from .kinds import Kind

_FILE: dict[str, Kind] = {
    **dict.fromkeys(("unit", "axes", "name"), kinds.TEXT),
    **dict.fromkeys(("x", "y", "z"), kinds.NUMBERS_OR_TEXT),
    **dict.fromkeys(("bounds", "spacing"), kinds.QUANTITIES),
}
_OWN: dict[str, Kind] = {
    **dict.fromkeys(("path", "model", "format"), kinds.TEXT),
    "fields": kinds.FIELDS,
    "derived": kinds.EXPRESSION_TABLE,
    "units": kinds.TEXT_TABLE,
}


@dataclass
class VolumeSource:
    """Source of a volume: a file (as in `io.open`) or the name of a function of `models`.

    `derived` are fields to add (name → expression), `units` those of plain fields, `options` those
    of the reader, or the arguments of the model.
    """

    path: str | None = None
    model: str | None = None
    format: str | None = None
    fields: FieldChoice = None
    derived: dict[str, Any] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)

    def build(self, directory: Path) -> Volume:
        """Return the volume; a relative path is relative to `directory`."""
        from ..io import find_reader
        from ..io import open as open_volume

        with placed("[volume]"):
            units, options = self.units, self.options
            if self.path is not None:
                path = seen_from(directory, self.path)
                if units and "units" in find_reader(path, self.format).options:
                    # Such a reader has units and converts the values itself.
                    units, options = {}, {**options, "units": units}
                volume = open_volume(path, self.fields, format=self.format, **options)
            else:
                volume = models()[str(self.model)](**options)
            for name, unit in units.items():
                volume.set_unit(name, unit)
            for name, expression in self.derived.items():
                volume[name] = Expression(expression)
        return volume

    def of_file(self, path: Path) -> Volume:
        """Return the volume in another file, read in the same way, with the same derived fields."""
        options = {} if self.path is None else self.options  # not those of a model
        return replace(self, path=str(path), model=None, options=options).build(Path())


def read_source(section: Mapping[str, Any]) -> VolumeSource:
    """Parse ``[volume]``; it is validated as far as possible without opening the file."""
    from ..io.registry import readers

    with placed("[volume]"):
        if ("path" in section) == ("model" in section):
            raise InputError("give path = a file, or model = one of " + ", ".join(sorted(models())))
        chosen = kinds.converted({k: v for k, v in section.items() if k in _OWN}, _OWN)
        source = VolumeSource(**chosen)
        options = {key: value for key, value in section.items() if key not in _OWN}
        if source.path is not None:
            known = {reader.name: reader for reader in readers()}
            if source.format is not None:
                check_name("format", source.format, known)
                asked = [known[source.format]]
            else:  # by name, compressed or not
                endings = {suffix.lower() for suffix in Path(source.path).suffixes}
                asked = [reader for reader in known.values() if endings & set(reader.suffixes)]
            if asked:  # otherwise the file's content determines the reader on opening
                kinds.check_keys(options, {*_OWN}.union(*(reader.options for reader in asked)))
            source.options = typed_options(options)
        else:
            if wrong := {"format", "fields"} & section.keys():
                raise InputError(f"{min(wrong)} belongs to a file (path = …), not to a model")
            check_name("model", source.model, models())
            source.options = kinds.arguments(models()[str(source.model)], options, {})
    with placed("[volume.units]"):
        for unit in source.units.values():
            parse_unit(unit)
    for name, text in source.derived.items():
        with placed(f"[volume.derived] {name}"):
            Expression(text)
    return source


def models() -> dict[str, Callable[..., Volume]]:
    """Return the functions of `voluminous.models` by name."""
    from .. import models as module

    return {
        name: function
        for name, function in vars(module).items()
        if inspect.isfunction(function)
        and function.__module__ == module.__name__
        and not name.startswith("_")
    }


def typed_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Convert plain values to the types that a reader expects."""
    return kinds.converted(options, _FILE)
