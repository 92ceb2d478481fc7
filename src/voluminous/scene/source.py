"""The section ``[volume]``: a file or a model, and derived fields."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import InputError, unknown_name
from ..expressions import Expression
from ..files import seen_from
from ..io.contract import FieldChoice, Reader
from ..io.guard import placed
from ..packages import room
from ..units import parse_unit
from ..volume import Volume
from . import kinds
from .kinds import Kind, arguments

_FILE: dict[str, Kind] = {
    **dict.fromkeys(("unit", "axes", "name"), kinds.TEXT),
    **dict.fromkeys(("x", "y", "z"), kinds.NUMBERS_OR_TEXT),
    **dict.fromkeys(("bounds", "spacing"), kinds.QUANTITIES),
}
_OWN = {"path", "model", "format", "fields", "derived", "units"}


@dataclass
class VolumeSource:
    """Source of a volume: a file or a model.

    Attributes
    ----------
    path, format, fields
        A file, as in `io.open`.
    model : str or None
        Alternatively the name of a function of `voluminous.models`.
    options : dict
        Options of the reader, or arguments of the model.
    derived, units : dict
        Fields to add (name → expression), and units of plain fields (name → unit).
    """

    path: str | None = None
    format: str | None = None
    fields: FieldChoice = None
    model: str | None = None
    options: dict[str, Any] = field(default_factory=dict)
    derived: dict[str, Any] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)

    def build(self, directory: Path) -> Volume:
        """Return the volume; a relative path is relative to `directory`."""
        with placed("[volume]"):
            if self.path is not None:
                volume = self._opened(seen_from(directory, self.path))
            else:
                volume = self._named(models()[str(self.model)](**self.options))
            for name, expression in self.derived.items():
                volume[name] = Expression(expression)
        return volume

    def _opened(self, path: Path) -> Volume:
        from ..io import find_reader
        from ..io import open as open_volume

        options = self.options
        converts = bool(self.units) and "units" in find_reader(path, self.format).options
        if converts:  # such a reader has units and converts the values itself
            options = {**options, "units": self.units}
        volume = open_volume(path, self.fields, format=self.format, **options)
        return volume if converts else self._named(volume)

    def _named(self, volume: Volume) -> Volume:
        """Return the volume with the given units assigned to its plain fields."""
        for name, unit in self.units.items():
            volume.set_unit(name, unit)
        return volume


def read_source(section: Mapping[str, Any]) -> VolumeSource:
    """Parse ``[volume]``; it is validated as far as possible without opening the file."""
    with placed("[volume]"):
        if ("path" in section) == ("model" in section):
            raise InputError("give path = a file, or model = one of " + ", ".join(sorted(models())))
        options = {key: value for key, value in section.items() if key not in _OWN}
        source = _file(section, options) if "path" in section else _model(section, options)
        source.units = kinds.TEXT_TABLE("units", section.get("units", {}))
        source.derived = kinds.EXPRESSION_TABLE("derived", section.get("derived", {}))
    with placed("[volume.units]"):
        for unit in source.units.values():
            parse_unit(unit)
    for name, text in source.derived.items():
        with placed(f"[volume.derived] {name}"):
            Expression(text)
    return source


def models() -> dict[str, Any]:
    """Return the functions of `voluminous.models` by name."""
    module = room("models")
    return {
        name: function
        for name, function in vars(module).items()
        if inspect.isfunction(function)
        and function.__module__ == module.__name__
        and not name.startswith("_")
    }


def _file(section: Mapping[str, Any], options: dict[str, Any]) -> VolumeSource:
    from ..io.registry import readers

    path = kinds.TEXT("path", section["path"])
    form = kinds.TEXT("format", section["format"]) if "format" in section else None
    known = {reader.name: reader for reader in readers()}
    if form is not None and form not in known:
        raise unknown_name("format", form, known)
    asked = [known[form]] if form else _named_like(Path(path), known.values())
    if asked:  # otherwise the file's content determines the reader on opening
        kinds.check_keys(options, {*_OWN}.union(*(reader.options for reader in asked)))
    return VolumeSource(
        path=path,
        format=form,
        fields=kinds.FIELDS("fields", section["fields"]) if "fields" in section else None,
        options=typed_options(options),
    )


def typed_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Convert plain values to the types that a reader expects."""
    return {key: _FILE.get(key, kinds.ANYTHING)(key, value) for key, value in options.items()}


def _named_like(path: Path, among: Iterable[Reader]) -> list[Reader]:
    """Return the readers whose suffixes match a file name, compressed or not."""
    endings = {suffix.lower() for suffix in path.suffixes}
    return [reader for reader in among if endings & set(reader.suffixes)]


def _model(section: Mapping[str, Any], options: dict[str, Any]) -> VolumeSource:
    name = kinds.TEXT("model", section["model"])
    for key in ("format", "fields"):
        if key in section:
            raise InputError(f"{key} belongs to a file (path = …), not to a model")
    if name not in models():
        raise unknown_name("model", name, models())
    return VolumeSource(model=name, options=arguments(models()[name], options, {}))
